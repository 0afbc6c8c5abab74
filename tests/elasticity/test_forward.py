from functools import cache

import numpy as np
import pytest
from skfem import Basis, ElementQuad2, ElementVector, LinearForm, MeshQuad, condense, solve
from skfem.helpers import dot

from eofm.elasticity import forward
from eofm.elasticity.forward import (
    background_field,
    deform,
    displacement,
    graded_basis,
    make_basis,
    solve_positive,
    stiffness_matrix,
)
from eofm.elasticity.material import lame
from eofm.errors import InputError
from eofm.grid import unit_spacing
from eofm.settings import Forward, Inclusion, Sample


def manufactured(n, nu):
    """L2 error on n x n cells for the divergence-free and a compressible part together."""
    sample = Sample(height=11, width=11, poisson_ratio=nu, compression=0)
    mesh = MeshQuad.init_tensor(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=6)
    lam, mu = (v.flat[0] for v in lame(sample, np.zeros((2, 1))))
    pi = np.pi

    def exact(x):
        # A rotation plus a compressible part that stays of size 1 / lambda as nu -> 1/2.
        s1, s2, c1, c2 = np.sin(pi * x[0]), np.sin(pi * x[1]), np.cos(pi * x[0]), np.cos(pi * x[1])
        return np.stack([s1 * c2, -c1 * s2]) + np.stack([s1 * s2, 0 * s1]) / (1 + lam)

    @LinearForm
    def load(v, w):
        x = w.x
        s1, s2, c1, c2 = np.sin(pi * x[0]), np.sin(pi * x[1]), np.cos(pi * x[0]), np.cos(pi * x[1])
        # -div sigma = -mu laplace(u) - (lambda + mu) grad div(u)
        f = 2 * pi**2 * mu * exact(x)
        grad_div = np.stack([-(pi**2) * s1 * s2, pi**2 * c1 * c2]) / (1 + lam)
        return dot(f - (lam + mu) * grad_div, v)

    x = basis.project(exact)
    u = solve(
        *condense(stiffness_matrix(basis, sample), load.assemble(basis), x=x, D=basis.get_dofs()),
        solver=solve_positive,
    )
    fine = np.asarray(basis.interpolate(u)) - exact(np.asarray(basis.global_coordinates()))
    return np.sqrt(((fine**2).sum(0) * basis.dx).sum())


@pytest.mark.parametrize("nu", [0.3, 0.495])
def test_biquadratic_elements_converge_with_rate_three(nu):
    """One order more than the bilinear elements' two, up to near incompressibility."""
    errors = [manufactured(n, nu) for n in (8, 16, 32)]
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(rates, 3, atol=0.1)


def test_no_locking():
    """The error on a coarse mesh does not grow as nu goes to 1/2."""
    coarse = [manufactured(8, nu) for nu in (0.3, 0.495, 0.4999)]
    assert max(coarse) < 1.5 * coarse[0]


@pytest.mark.parametrize("plane", ["strain", "stress"])
def test_patch_test_is_exact(plane, rng):
    """A linear displacement on the boundary continues linearly inside."""
    sample = Sample(height=9, width=14, poisson_ratio=0.45, plane=plane)
    basis = make_basis(sample, 2.0)
    G = rng.normal(size=(2, 2))
    linear = basis.project(lambda x: np.einsum("ij,j...->i...", G, x))
    K = stiffness_matrix(basis, sample)
    u = solve(*condense(K, x=linear, D=basis.get_dofs()), solver=solve_positive)
    np.testing.assert_allclose(u, linear, atol=1e-9)


def test_stiffness_is_symmetric_and_positive_definite_once_held():
    sample = Sample(height=9, width=12, inclusions=[Inclusion(x1=5, x2=4, radius=2.5, stiffness=9)])
    basis = make_basis(sample, 2.0)
    K = stiffness_matrix(basis, sample)
    assert abs(K - K.T).max() < 1e-12
    interior = basis.complement_dofs(basis.get_dofs(lambda x: x[1] == 0))
    assert np.linalg.eigvalsh(K[interior][:, interior].toarray()).min() > 0


def test_slip_plane_stress_is_uniaxial_compression():
    """An independent oracle: the closed form u1 = nu c x1 / H, u2 = -c x2 / H."""
    sample = Sample(
        height=21, width=31, poisson_ratio=0.3, plane="stress", contact="slip", compression=1.0
    )
    u = displacement(sample, cell=5.0)
    x2, x1 = np.mgrid[:21, :31]
    np.testing.assert_allclose(u[1], -x2 / 20, atol=1e-9)
    np.testing.assert_allclose(u[0], 0.3 * (x1 - 15) / 20, atol=1e-9)


def test_slip_plane_strain_is_uniaxial_compression():
    sample = Sample(height=21, width=31, poisson_ratio=0.3, contact="slip", compression=1.0)
    u = displacement(sample, cell=5.0)
    x1 = np.arange(31)
    np.testing.assert_allclose(u[0], np.tile(0.3 / 0.7 * (x1 - 15) / 20, (21, 1)), atol=1e-9)


@pytest.mark.parametrize(("height", "width"), [(20, 31), (25, 18), (16, 16)])
def test_symmetric_sample_moves_symmetrically(height, width):
    centre = {"x1": (width - 1) / 2, "x2": 9.0, "radius": 4.0, "stiffness": 5.0}
    u = displacement(Sample(height=height, width=width, inclusions=[centre]), 1.0)
    np.testing.assert_allclose(u[0], -u[0, :, ::-1], atol=1e-9)
    np.testing.assert_allclose(u[1], u[1, :, ::-1], atol=1e-9)


def test_no_compression_gives_zero():
    np.testing.assert_allclose(
        displacement(Sample(height=12, width=15, compression=0), 3.0), 0, atol=1e-10
    )


def test_meshes_agree(sample, truth):
    coarse = displacement(sample, 2.0)
    assert np.linalg.norm(coarse - truth) < 0.01 * np.linalg.norm(truth)
    plain = sample.changed(inclusions=())
    fine = displacement(plain, 1.0)
    assert np.linalg.norm(displacement(plain, 4.0) - fine) < 0.005 * np.linalg.norm(fine)


def pressed(c):
    return {"top": np.zeros((2, 1)), "bottom": np.array([[0.0], [-c]])}


@cache
def on_fine_mesh(sample, pixel_size):
    """A homogeneous field on several times the cells of the meshes that are accepted."""
    spacing = unit_spacing(pixel_size)
    motion, basis = pressed(0.033 * sample.height), graded_basis(sample, 100, spacing)
    return forward._solve(sample, motion, basis, spacing)


@pytest.mark.parametrize(
    ("height", "width", "nu", "pixel_size"),
    [
        (108, 180, 0.492, (1.0, 1.0)),
        (61, 90, 0.48, (2.0, 1.0)),
        (90, 33, 0.3, (1.0, 3.0)),
        (401, 300, 0.4999, (1.0, 1.0)),
        (700, 700, 0.45, (1.0, 1.0)),
    ],
)
@pytest.mark.parametrize("error", [1e-2, 1e-3])
def test_error_of_a_homogeneous_field_is_as_wanted(height, width, nu, pixel_size, error):
    sample = Sample(height=height, width=width, poisson_ratio=nu, compression=0.0)
    u = deform(sample, pressed(0.033 * height), error=error, pixel_size=pixel_size)
    assert np.abs(u - on_fine_mesh(sample, pixel_size)).max() <= error


def test_graded_and_uniform_meshes_agree():
    """Uniform meshes, of which the corners are the worst part, converge to the same field."""
    sample = Sample(height=31, width=46, poisson_ratio=0.49, compression=1.0)
    u = background_field(sample, Forward(background_error=1e-4))
    errors = [np.abs(displacement(sample, cell) - u) for cell in (2.0, 1.0, 0.5)]
    largest = [e.max() for e in errors]
    assert largest[2] < 3e-3
    assert largest[2] < largest[1] < largest[0]
    # The energy of the singular part that a uniform mesh misses falls with rate one at least.
    inside = [e[:, 4:-4].max() for e in errors]
    assert inside[2] < 0.55 * inside[1] < 0.55**2 * inside[0]


def test_cells_do_not_grow_with_the_pixels(monkeypatch):
    used = []

    def solve_on(sample, motion, basis, *others):
        used.append(basis.mesh.nelements)
        return np.zeros((2, *sample.shape))

    monkeypatch.setattr(forward, "_solve", solve_on)
    monkeypatch.setattr(forward, "_missed", lambda *_: np.inf)
    for shape in ((64, 96), (2000, 3000), (400, 33)):
        used.clear()
        deform(Sample(height=shape[0], width=shape[1]), {})
        assert used == sorted(used)
        np.testing.assert_allclose(used, np.square(forward.MESHES), rtol=0.1)


def test_edges_move_as_prescribed():
    sample = Sample(height=60, width=80, compression=0.0)
    bump = np.exp(-((np.arange(80) - 43.3) ** 2) / (2 * 5.0**2))
    g = np.stack([0.1 * bump, -1 - 0.2 * bump])
    u = deform(sample, {"top": np.zeros((2, 1)), "bottom": g})
    np.testing.assert_allclose(u[:, -1, 1:-1], g[:, 1:-1], atol=2e-3)
    np.testing.assert_allclose(u[:, 0], 0, atol=1e-9)
    sideways = deform(sample, {"left": np.array([[0.5], [0.0]]), "right": np.zeros((2, 1))})
    np.testing.assert_allclose(sideways[0, :, 0], 0.5, atol=1e-9)
    np.testing.assert_allclose(sideways[:, :, -1], 0, atol=1e-9)


def test_an_edge_may_slide_sideways_or_be_held_along_alone():
    """Pure compression between plates of which one sticks in the lateral direction at a point."""
    sample = Sample(height=41, width=61, poisson_ratio=0.3)
    x2, x1 = np.mgrid[:41, :61]
    slides = {"top": np.array([[np.nan], [0.0]]), "bottom": np.array([[np.nan], [-1.0]])}
    stretch = 0.3 / 0.7 / 40
    exact = np.stack([stretch * (x1 - 30), -x2 / 40])
    np.testing.assert_allclose(deform(sample, slides), exact, atol=1e-6)
    # Held at the left side along its normal, it is that side that stays where it is.
    held = slides | {"left": np.array([[0.25], [np.nan]])}
    moved = exact + np.reshape([0.25 + 30 * stretch, 0], (2, 1, 1))
    np.testing.assert_allclose(deform(sample, held), moved, atol=1e-6)


def test_what_may_turn_is_refused():
    sample = Sample(height=20, width=30)
    with pytest.raises(InputError, match="free to turn"):
        deform(sample, {"left": np.array([[np.nan], [0.0]])})
