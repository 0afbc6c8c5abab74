"""The forms a and b against an independent assembly, and their convergence."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import scipy.sparse as sp
from conftest import speckle
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import direct
from skfem import Basis, BilinearForm, ElementHex1, ElementQuad1, LinearForm, MeshHex, MeshQuad
from skfem.helpers import dot, grad

from eofm.flow.functional import (
    Pointwise,
    Quadratic,
    data_term,
    pairs,
    signs,
    smoothness_energy,
    speckle_term,
)
from eofm.flow.multigrid import multigrid
from eofm.grid import Grid
from eofm.imaging.splines import gradient

SIZES = [(8, 8), (9, 14), (13, 7), (16, 31), (5, 8, 7), (6, 4, 9)]
ELEMENTS = {2: (MeshQuad, ElementQuad1()), 3: (MeshHex, ElementHex1())}


def problem(shape, rng, spacing=None, alpha=0.8, smoothness="gradient", edges=True):
    n = len(shape)
    spacing = (1.0,) * n if spacing is None else spacing
    grid = Grid(shape, spacing)
    I1, I2 = speckle(shape, rng), speckle(shape, rng)
    g = np.stack(np.gradient(I1, *spacing[::-1])[::-1]) if n == 3 else gradient(I1, spacing)
    data = data_term(g, I2 - I1, rng.random(shape) < 0.9)
    x = rng.uniform(0, 1, (n, 6)) * np.reshape(grid.lengths, (n, 1))
    free = np.ones(shape, bool)
    if edges:
        free[[0, -1]] = False
    terms = data + speckle_term(grid, x, rng.normal(size=(n, 6)), 0.5, 2.0)
    return Quadratic(grid, terms, alpha, free, smoothness)


def by_scikit_fem(F):
    """a and b assembled by scikit-fem with the same quadrature, on all pixels."""
    n = F.grid.ndim
    mesh, element = ELEMENTS[n]
    vertices = np.array(list(product((0.0, 1.0), repeat=n))).T
    quadrature = vertices, np.full(2**n, 0.5**n)
    basis = Basis(mesh.init_tensor(*F.grid.axes), element, quadrature=quadrature)
    # Index of the pixel under each node, and under each quadrature point.
    h = np.array(F.grid.spacing)
    pixel = np.rint(basis.doflocs.T / h).astype(int)
    order = np.lexsort(pixel.T)
    points = np.asarray(basis.global_coordinates()) / h[:, None, None]
    at = tuple(np.rint(points).astype(int)[::-1])

    @BilinearForm
    def stiffness(u, v, w):
        return F.alpha * dot(grad(u), grad(v))

    def mass(values):
        return BilinearForm(lambda u, v, w: values[at] * u * v).assemble(basis)

    def load(values):
        return LinearForm(lambda v, w: values[at] * v).assemble(basis)

    R = stiffness.assemble(basis)
    blocks = [[None] * n for _ in range(n)]
    for A, (i, j) in zip(F.terms.A, pairs(n), strict=True):
        blocks[i][j] = blocks[j][i] = mass(A) + R if i == j else mass(A)
    a = 2 * sp.block_array(blocks, format="csr")
    b = 2 * np.concatenate([load(c) for c in F.terms.b])
    all_of_them = np.concatenate([order + c * len(order) for c in range(n)])
    keep = np.flatnonzero(np.tile(F.free.ravel(), n))
    return a[all_of_them][:, all_of_them][keep][:, keep], b[all_of_them][keep]


@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize("edges", [True, False])
def test_forms_agree_with_scikit_fem(shape, edges, rng):
    F = problem(shape, rng, (1.5, 0.8, 1.1)[: len(shape)], edges=edges)
    a, b = by_scikit_fem(F)
    assert abs(F.a() - a).max() < 1e-8 * abs(a).max()
    np.testing.assert_allclose(F.b(), b, atol=1e-8 * abs(b).max())


@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize("smoothness", ["gradient", "bending"])
def test_a_is_symmetric_positive_definite(shape, smoothness, rng):
    a = problem(shape, rng, smoothness=smoothness).a().toarray()
    np.testing.assert_allclose(a, a.T, atol=1e-12 * abs(a).max())
    assert np.linalg.eigvalsh(a).min() > 0


@given(st.integers(8, 20), st.integers(8, 20), st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_minimiser_beats_its_neighbours(height, width, seed):
    rng = np.random.default_rng(seed)
    F = problem((height, width), rng)
    v = direct(F)[:, F.free].ravel()

    def value(x):
        return x @ (F.a() @ x) / 2 - F.b() @ x

    for _ in range(3):
        assert value(v) <= value(v + 0.01 * rng.normal(size=v.shape))


def test_smoothness_energies_of_polynomials():
    grid = Grid((17, 26), (1.2, 0.7))
    x1, x2 = np.meshgrid(*grid.axes)
    area = np.prod(grid.lengths)
    for f, first, second in [(1 + 0 * x1, 0, 0), (3 * x1 - x2, 10, 0), (x1 * x2, None, 2)]:
        f = f.ravel()
        if first is not None:
            assert f @ (smoothness_energy(grid, "gradient") @ f) == pytest.approx(
                first * area, abs=1e-9
            )
        assert f @ (smoothness_energy(grid, "bending") @ f) == pytest.approx(
            second * area, rel=1e-10, abs=1e-8
        )


@pytest.mark.parametrize("smoothness", ["gradient", "bending"])
def test_rough_functionals_have_the_covariance_of_the_smoothness(smoothness):
    shape = (8, 9)
    terms = Pointwise(np.zeros((3, *shape)), np.zeros((2, *shape)))
    F = Quadratic(Grid(shape, (1.2, 0.8)), terms, 0.7, np.ones(shape, dtype=bool), smoothness)

    class Unit:
        """Deals the k-th unit vector instead of noise, in the pieces that are asked for."""

        def __init__(self, k):
            self.left = k

        def integers(self, high, size, dtype):
            assert high == 2  # of which signs are made: 0.5 becomes 0
            z = np.full(size, 0.5)
            if 0 <= self.left < z.size:
                z.flat[self.left] = 1
            self.left -= z.size
            return z

    root = [draw for k in range(1000) if (draw := F.rough(Unit(k)).ravel()).any()]
    root = np.stack(root)
    assert len(root) < 900  # all of them
    np.testing.assert_allclose(root.T @ root, F.a().toarray() / 2, atol=1e-12)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.87358, 0.65519, 1.74716)])
def test_smoothness_asks_nothing_of_an_affine_field(spacing):
    """Of a volume in single precision, whose sides are rounded, too: its values alone are."""
    shape = (24, 28, 22)
    terms = Pointwise(np.zeros((6, *shape), np.float32), np.zeros((3, *shape), np.float32))
    F = Quadratic(Grid(shape, spacing), terms, 1.0, np.ones(shape, dtype=bool), "bending")
    x = np.indices(shape)[::-1] * np.reshape(spacing, (3, 1, 1, 1))
    v = np.stack([0.05 * x[0] - 0.02 * x[1], 0.04 * x[1], 0.03 * x[2] + 1]).astype(np.float32)
    # What stretches the whole; that of factors in single precision would be 0.1.
    force, x = F.smoothed(v) * F.grid.areas, x - x.mean(axis=(1, 2, 3), keepdims=True)
    moments = np.abs(np.einsum("cijk,dijk->cd", force, x))
    assert moments.max() < 1e-6


def test_signs_are_white_and_of_variance_1(rng):
    z = signs(rng, (200, 300), np.float32)
    assert z.dtype == np.float32
    assert set(np.unique(z)) == {-1, 1}
    for mean in (z.mean(), (z[1:] * z[:-1]).mean(), (z[:, 1:] * z[:, :-1]).mean()):
        assert abs(mean) < 4 / np.sqrt(z.size)


def test_data_term_is_the_square_of_the_flow_equation(rng):
    grad_I, I_t, v = rng.normal(size=(2, 5, 6)), rng.normal(size=(5, 6)), rng.normal(size=(2, 5, 6))
    inside = rng.random((5, 6)) < 0.7
    term = data_term(grad_I, I_t, inside)
    A11, A12, A22 = term.A
    density = A11 * v[0] ** 2 + 2 * A12 * v[0] * v[1] + A22 * v[1] ** 2 - 2 * (term.b * v).sum(0)
    expected = inside * (((grad_I * v).sum(0) + I_t) ** 2 - I_t**2)
    np.testing.assert_allclose(density, expected, atol=1e-12)


def test_one_bubble_weighs_beta():
    grid = Grid((61, 71))
    term = speckle_term(grid, np.array([[33.3], [29.6]]), np.array([[2.0], [-1.0]]), 0.5, 4.0)
    assert term.A[0].sum() == pytest.approx(0.5, rel=1e-6)
    np.testing.assert_allclose(term.b.sum((1, 2)), [1.0, -0.5], rtol=1e-6)
    assert not term.A[1].any()


def test_a_slice_through_bubbles_has_the_term_of_an_image_of_them():
    x, motion = np.array([[8.2, 13.0], [9.7, 12.1]]), np.array([[2.0, 0.5], [-1.0, 0.3]])
    image = speckle_term(Grid((20, 22)), x, motion, 0.5, 4.0)
    at = np.concatenate([x, np.full((1, 2), 6.0)])
    volume = speckle_term(Grid((14, 20, 22)), at, np.concatenate([motion, motion[:1]]), 0.5, 4.0)
    np.testing.assert_allclose(volume.A[0][6], image.A[0], rtol=1e-5)
    np.testing.assert_allclose(volume.b[:2, 6], image.b, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("smoothness", ["gradient", "bending"])
@pytest.mark.parametrize("shape", [(12, 17), (6, 9, 8)])
def test_shifting_moves_the_minimiser(shape, smoothness, rng):
    F = problem(shape, rng, (1.5, 0.8, 1.1)[: len(shape)], smoothness=smoothness)
    p = rng.normal(size=F.terms.b.shape)
    everywhere = replace(F, free=np.ones(shape, dtype=bool))
    expected = everywhere.b() - everywhere.a() @ p.ravel()
    tolerance = 1e-6 * np.abs(expected).max()
    np.testing.assert_allclose(
        replace(F.shifted(p), free=everywhere.free).b(), expected, atol=tolerance
    )


def manufactured(n, smooth=0.8):
    """Error of the solution of a smooth problem with known solution on n x n cells."""
    grid = Grid((n + 1, n + 1), (1 / n, 1 / n))
    x1, x2 = np.meshgrid(*grid.axes)
    s, c, pi = np.sin, np.cos, np.pi
    # v = 0 on top and bottom, natural on the sides.
    v = np.stack([c(pi * x1) * s(pi * x2), c(2 * pi * x1) * s(pi * x2)])
    laplace = -np.stack([2 * pi**2 * v[0], 5 * pi**2 * v[1]])
    grad_I = np.stack([1 + x1 * x2, c(x2)])
    A = np.stack([grad_I[0] ** 2 + 1, grad_I[0] * grad_I[1], grad_I[1] ** 2 + 1])
    load = -smooth * laplace + np.stack([A[0] * v[0] + A[1] * v[1], A[1] * v[0] + A[2] * v[1]])
    free = np.ones(grid.shape, bool)
    free[[0, -1]] = False
    error = direct(Quadratic(grid, Pointwise(A, load), smooth, free)) - v
    return np.sqrt((error**2).mean())


def manufactured_volume(n, smooth=0.8):
    """The same on n x n x n cells, solved by multigrid."""
    grid = Grid((n + 1,) * 3, (1 / n,) * 3)
    x3, x2, x1 = np.meshgrid(*grid.axes[::-1], indexing="ij")
    s, c, pi = np.sin, np.cos, np.pi
    # v = 0 on the first and last slice, natural on the other faces.
    v = np.stack([c(k * pi * x1) * c(pi * x2) * s(pi * x3) for k in (1, 2, 0)])
    laplace = -(pi**2) * np.reshape([3, 6, 2], (3, 1, 1, 1)) * v
    g = np.stack([1 + x1 * x2, c(x2), 1 + x3 * x1])
    A = np.stack([g[i] * g[j] + (i == j) for i, j in pairs(3)])
    free = np.ones(grid.shape, bool)
    free[[0, -1]] = False
    load = -smooth * laplace + Pointwise(A, v).product(v)
    error = multigrid(Quadratic(grid, Pointwise(A, load), smooth, free), tol=1e-10) - v
    return np.sqrt((error**2).mean())


@pytest.mark.parametrize(
    ("solve", "sizes"), [(manufactured, (16, 32, 64)), (manufactured_volume, (8, 16, 32))]
)
def test_manufactured_solution_converges_with_rate_two(solve, sizes):
    errors = [solve(n) for n in sizes]
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(rates, 2, atol=0.1)


def test_no_data_reproduces_nothing_and_a_constant_bubble_field_is_exact(rng):
    """Patch test: with natural edges a constant motion of all bubbles is the solution."""
    grid = Grid((15, 22))
    x = rng.uniform(0, 1, (2, 9)) * [[21], [14]]
    motion = np.tile([[1.25], [-2.5]], 9)
    F = Quadratic(grid, speckle_term(grid, x, motion, 0.5, 3.0), 0.8, np.ones(grid.shape, bool))
    np.testing.assert_allclose(direct(F)[0], 1.25, atol=1e-9)
    np.testing.assert_allclose(direct(F)[1], -2.5, atol=1e-9)


@pytest.mark.parametrize(("smoothness", "wanted"), [("gradient", 1 / 3 + 1 / 3), ("bending", 2.0)])
def test_smoothness_of_a_volume_counts_every_derivative(smoothness, wanted):
    """The same loops in three dimensions: x1 x3 on the unit cube, and nothing for a constant."""
    n = 65
    grid = Grid((n, 5, n), (1 / (n - 1), 1 / 4, 1 / (n - 1)))
    x1, _, x3 = np.meshgrid(*grid.axes, indexing="ij")
    R = smoothness_energy(grid, smoothness)
    v = (x1 * x3).transpose(2, 1, 0).ravel()
    assert v @ (R @ v) == pytest.approx(wanted, rel=1e-3)
    assert abs(R @ np.ones(v.size)).max() < 1e-6
