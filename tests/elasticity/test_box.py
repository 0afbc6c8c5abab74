"""Boxes in three dimensions: bricks against other programs and closed forms."""

import numpy as np
import pytest
from skfem import Basis, BilinearForm, ElementHex0, ElementHex2, ElementVector, MeshHex, condense
from skfem.helpers import ddot, div, sym_grad

from eofm.compiled import use_threads
from eofm.elasticity.box import graded
from eofm.elasticity.bricks import Bricks
from eofm.elasticity.forward import background_field, deform, displacement, press, solve_positive
from eofm.elasticity.material import lame
from eofm.errors import InputError
from eofm.settings import Forward, Inclusion, Sample


def material(nu):
    sample = Sample(height=9, width=9, depth=9, poisson_ratio=nu)
    return tuple(float(c) for c in lame(sample, np.zeros(3)))


def mesh(cells, lengths=(1.0, 1.0, 1.0), nu=0.48, rng=None):
    sides = tuple(L * np.diff(graded(n)) for L, n in zip(lengths, cells, strict=True))
    E = np.ones(cells[::-1]) if rng is None else rng.uniform(0.5, 3, cells[::-1])
    return Bricks(sides, material(nu), E)


def places(bricks):
    return np.stack(np.meshgrid(*bricks.nodes[::-1], indexing="ij")[::-1])


def border(bricks):
    on = np.ones((3, *bricks.shape), dtype=bool)
    on[:, 1:-1, 1:-1, 1:-1] = False
    return on


def direct(bricks, u, held):
    """The same problem assembled by scikit-fem and solved by a factorisation."""
    ends = [np.concatenate([[0], np.cumsum(h)]) for h in bricks.sides]
    grid = MeshHex.init_tensor(*ends)
    basis = Basis(grid, ElementVector(ElementHex2()), intorder=4)
    reduced = Basis(grid, basis.elem, intorder=3)
    lam, mu = bricks.lame
    cell = [np.searchsorted(e, c) - 1 for e, c in zip(ends, grid.p[:, grid.t].mean(1), strict=True)]
    values = bricks.E[tuple(cell[::-1])]

    @BilinearForm
    def shear(u, v, w):
        return 2 * mu * w.E * ddot(sym_grad(u), sym_grad(v))

    @BilinearForm
    def volume(u, v, w):
        return lam * w.E * div(u) * div(v)

    K = sum(
        form.assemble(b, E=b.with_element(ElementHex0()).interpolate(values))
        for form, b in ((shear, basis), (volume, reduced))
    )
    kinds = basis.nodal_dofs, basis.edge_dofs, basis.facet_dofs, basis.interior_dofs
    dofs = np.stack([np.concatenate([d[i::3].ravel() for d in kinds]) for i in range(3)])
    at = [
        np.abs(np.subtract.outer(c, n)).argmin(1)
        for c, n in zip(basis.doflocs[:, dofs[0]], bricks.nodes, strict=True)
    ]
    there = tuple(at[::-1])
    x = basis.zeros()
    x[dofs] = u[:, *there]
    found = np.empty_like(u)
    fixed = dofs[held[:, *there]]
    A, b, solved, free = condense(K, x=x, D=fixed)
    solved[free] = solve_positive(A, b)
    found[:, *there] = solved[dofs]
    return K, dofs, there, found


def test_the_operator_is_that_of_scikit_fem(rng):
    bricks = mesh((3, 2, 4), (5.0, 3.0, 4.0), rng=rng)
    u = rng.normal(size=(3, *bricks.shape))
    K, dofs, there, _ = direct(bricks, u, border(bricks))
    x = np.zeros(K.shape[0])
    x[dofs] = u[:, *there]
    np.testing.assert_allclose(bricks.forces(u)[:, *there], (K @ x)[dofs], atol=1e-9)


@pytest.mark.parametrize("held", ["all", "top and bottom", "slip"])
def test_the_solution_is_that_of_a_direct_solver(held, rng):
    bricks = mesh((4, 3, 3), (5.0, 3.0, 4.0), rng=rng)
    u, on = np.zeros((3, *bricks.shape)), np.zeros((3, *bricks.shape), dtype=bool)
    if held == "all":
        on = border(bricks)
    elif held == "top and bottom":
        on[:, :, [0, -1]] = True
    else:
        # Each face along its normal alone, some of them.
        on[1, :, [0, -1]], on[0, ..., 0], on[2, 0] = True, True, True
    u[on] = rng.normal(size=on.sum())
    *_, expected = direct(bricks, u, on)
    # The energy of the error has fallen by 1e-12, and the data are as rough as can be.
    np.testing.assert_allclose(bricks.solve(u, on), expected, atol=1e-4)


def test_linear_motion_of_the_border_continues_inside(rng):
    bricks = mesh((5, 4, 6), (3.0, 2.0, 4.0), nu=0.495)
    G = rng.normal(size=(3, 3))
    linear, on = np.einsum("ij,j...->i...", G, places(bricks)), border(bricks)
    np.testing.assert_allclose(bricks.solve(np.where(on, linear, 0), on), linear, atol=1e-5)


def papkovich_neuber(x, nu):
    """Equilibrium without body forces: ``4 (1 - nu) B - grad(x . B)`` of a harmonic B along x3."""
    a, b, c = 1.5, 2.0, 2.5
    s1, c1, s2, c2 = np.sin(a * x[0]), np.cos(a * x[0]), np.sin(b * x[1]), np.cos(b * x[1])
    e = np.exp(c * (x[2] - 1))
    B = s1 * c2 * e
    slope = np.stack([a * c1 * c2 * e, -b * s1 * s2 * e, c * B])
    u = -x[2] * slope
    u[2] += (3 - 4 * nu) * B
    return u


def error(n, nu):
    sides = (np.full(n, 1 / n),) * 3
    bricks = Bricks(sides, material(nu), np.ones((n, n, n)))
    exact, on = papkovich_neuber(places(bricks), nu), border(bricks)
    u = bricks.solve(np.where(on, exact, 0), on)
    # At the middles of bricks, halfway between nodes in no direction, the error is typical.
    return np.sqrt(np.mean((u - exact)[:, 1::2, 1::2, 1::2] ** 2))


@pytest.mark.parametrize("nu", [0.3, 0.495])
def test_bricks_converge_with_rate_three_at_least(nu):
    errors = [error(n, nu) for n in (3, 6, 12)]
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (rates > 2.8).all()


def test_no_locking():
    """The error on a coarse mesh does not grow as nu goes to 1/2, where lambda is without bound."""
    coarse = [error(4, nu) for nu in (0.49, 0.495, 0.4999)]
    assert max(coarse) < 1.5 * coarse[0]


def test_symmetry_planes_in_front_and_back_give_plane_strain():
    box = Sample(height=33, width=49, depth=12, poisson_ratio=0.48, compression=2.0)
    normal = np.array([np.nan, np.nan, 0.0]).reshape(3, 1, 1)
    u = deform(box, press(box) | {"front": normal, "back": normal}, error=1e-3)
    image = background_field(box.changed(depth=None), Forward(background_error=1e-4))
    np.testing.assert_allclose(u[2], 0, atol=1e-6)
    np.testing.assert_allclose(u[:2], np.broadcast_to(image[:, None], u[:2].shape), atol=2e-3)


def test_slip_is_uniaxial_compression():
    """The closed form u1 = nu c x1 / H and u2 = -c x2 / H, and u3 as u1."""
    box = Sample(height=21, width=31, depth=11, poisson_ratio=0.3, contact="slip", compression=1.0)
    x3, x2, x1 = np.mgrid[:11, :21, :31]
    exact = np.stack([0.3 * (x1 - 15), -x2, 0.3 * (x3 - 5)]) / 20
    np.testing.assert_allclose(displacement(box, cell=5.0), exact, atol=1e-5)
    np.testing.assert_allclose(background_field(box), exact, atol=1e-5)


def test_voxels_that_are_no_cubes():
    """A compression in um is the same whatever the voxels: here 2 x 1 x 4."""
    motion = press(Sample(height=33, width=33, depth=33, compression=3.0))
    even = deform(Sample(height=33, width=33, depth=33), motion, error=3e-3)
    other = deform(
        Sample(height=33, width=17, depth=9), motion, error=3e-3, pixel_size=(2.0, 1.0, 4.0)
    )
    scaled = other * np.reshape([2.0, 1.0, 4.0], (3, 1, 1, 1))
    np.testing.assert_allclose(scaled, even[:, ::4, :, ::2], atol=5e-3)


def test_faces_move_as_prescribed():
    box = Sample(height=40, width=50, depth=30)
    x3, x1 = np.mgrid[:30, :50].astype(float)
    bump = np.exp(-((x1 - 20) ** 2 + (x3 - 12) ** 2) / (2 * 6.0**2))
    g = np.stack([0.1 * bump, -1 - 0.3 * bump, 0 * bump])
    u = deform(box, {"top": np.zeros((3, 1, 1)), "bottom": g}, error=5e-3)
    assert u.dtype == np.float32
    np.testing.assert_allclose(u[:, 1:-1, -1, 1:-1], g[:, 1:-1, 1:-1], atol=5e-3)
    np.testing.assert_allclose(u[:, :, 0], 0, atol=1e-6)
    u = deform(box, {"front": np.reshape([0.5, 0.2, 0.1], (3, 1, 1))}, error=1e-2)
    np.testing.assert_allclose(u - np.reshape([0.5, 0.2, 0.1], (3, 1, 1, 1)), 0, atol=1e-5)
    np.testing.assert_allclose(deform(box, {}, error=1e-2), 0, atol=1e-12)


SPHERE = Inclusion(x1=14.5, x2=12, x3=10.5, radius=6, stiffness=8)
BALL = Sample(height=25, width=30, depth=22, compression=1.5, inclusions=(SPHERE,))


def test_a_sphere_in_the_middle_moves_symmetrically():
    u = displacement(BALL, 2.5)
    np.testing.assert_allclose(u[0], -u[0, :, :, ::-1], atol=1e-5)
    np.testing.assert_allclose(u[2], -u[2, ::-1], atol=1e-5)
    np.testing.assert_allclose(u[1], u[1, ::-1, :, ::-1], atol=1e-5)
    # A stiff sphere is strained less than its sample.
    strain = np.gradient(u[1], axis=1)
    assert abs(strain[10, 12, 15]) < 0.4 * abs(strain[10, 12, 2])


def test_meshes_agree():
    fine = displacement(BALL, 1.25)
    errors = [np.linalg.norm(displacement(BALL, c) - fine) / np.linalg.norm(fine) for c in (5, 2.5)]
    assert errors[1] < 0.02
    assert errors[1] < 0.5 * errors[0]
    plain = BALL.changed(inclusions=())
    u = background_field(plain, Forward(background_error=3e-3))
    assert np.abs(displacement(plain, 1.25) - u)[:, 3:-3, 3:-3, 3:-3].max() < 5e-3


def test_any_number_of_threads_gives_the_same_bytes():
    fields = []
    for threads in (1, 2, 3):
        use_threads(threads)
        fields.append(displacement(BALL, 2.5).tobytes())
    assert len(set(fields)) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plane": "stress"}, "no plane stress"),
        ({"depth": None}, "number 1 wants no x3"),
        ({"inclusions": [SPHERE.changed(x3=None)]}, "number 1 wants x3"),
        ({"depth": 5}, "depth"),
    ],
)
def test_samples_are_images_or_volumes(changes, message):
    with pytest.raises(InputError, match=message):
        BALL.changed(**changes)
