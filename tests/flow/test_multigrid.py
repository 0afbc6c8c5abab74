"""The multigrid solver against the direct one, and what conjugate gradients need of it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import direct
from scipy.ndimage import gaussian_filter

from eofm.compiled import use_threads
from eofm.errors import InputError
from eofm.flow import stencils
from eofm.flow.functional import Pointwise, Quadratic
from eofm.flow.multigrid import NotConverged, finest, hierarchy, multigrid
from eofm.grid import Grid

SMOOTHNESS = ("gradient", "bending")


def problem(
    shape, smoothness, *, spacing=(1.0, 1.0), image="speckle", free="rows", alpha=0.1, seed=0,
    scale=1.0, speckle=0.0,
):  # fmt: skip
    """A functional with the data term of an image of a kind, and pixels fixed in a way."""
    rng = np.random.default_rng(seed)
    I = rng.normal(size=shape)
    if image == "bubbles":
        I = np.where(rng.random(shape) < 1 / 400, 30 * rng.random(shape), 0.0)
    elif image == "half":
        I[shape[0] // 2 :] = 0.0
    I = scale * gaussian_filter(I, 1.5, mode="constant")
    if image != "speckle":
        I[[0, -1]] += scale * rng.random((2, shape[1]))  # determines all motions
    g2, g1 = np.gradient(I, *spacing[::-1])
    I_t = 0.3 * g1 - 0.5 * g2 + 0.05 * scale * rng.normal(size=shape) * (g1 != 0)
    A = np.stack([g1 * g1 + speckle, g1 * g2, g2 * g2 + speckle])
    mask = np.ones(shape, dtype=bool)
    if free == "rows":
        mask[[0, -1]] = False
    elif free == "edges":
        mask[:2] = mask[:, [0, -1]] = False
    elif free == "pixels":
        mask[tuple(rng.integers(0, s, 5) for s in shape)] = False
    b = Pointwise(A, -I_t * np.stack([g1, g2]))
    return Quadratic(Grid(shape, spacing), b, alpha, mask, smoothness)


def solve(F, **options):
    """The solution and the residuals."""
    residuals = []
    v = multigrid(F, report=lambda _, residual: residuals.append(residual), **options)
    assert v.shape == F.terms.b.shape
    return v, residuals


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    shape=st.tuples(st.integers(8, 70), st.integers(8, 70)),
    spacing=st.tuples(st.sampled_from([0.5, 1.0, 1.7]), st.sampled_from([0.5, 1.0, 2.0])),
    image=st.sampled_from(["speckle", "bubbles", "half"]),
    free=st.sampled_from(["rows", "edges", "pixels", "all"]),
    alpha=st.floats(-3, 2).map(lambda e: 10**e),
    scale=st.sampled_from([1.0, 255.0]),
    speckle=st.sampled_from([0.0, 0.3]),
    smoothness=st.sampled_from(SMOOTHNESS),
    seed=st.integers(0, 99),
)
def test_agrees_with_the_direct_solver(shape, smoothness, **kind):
    F = problem(shape, smoothness, **kind)
    u, (v, _) = direct(F), solve(F, tol=1e-12)
    assert np.abs(v - u).max() <= 1e-7 * np.abs(u).max()
    assert (v[:, ~F.free] == 0).all()


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize(
    ("shape", "spacing"),
    [
        ((8, 500), (1.0, 1.0)),
        ((17, 333), (1.0, 1.0)),
        ((67, 71), (1.0, 1.0)),
        ((96, 64), (4.0, 1.0)),
        ((50, 130), (1.0, 3.0)),
    ],
)
@pytest.mark.parametrize(("image", "scale"), [("speckle", 1.0), ("bubbles", 1.0), ("half", 255.0)])
@pytest.mark.parametrize(("alpha", "free"), [(1e-3, "all"), (0.3, "pixels"), (100.0, "edges")])
def test_few_iterations(shape, spacing, smoothness, image, scale, alpha, free):
    F = problem(
        shape, smoothness, spacing=spacing, image=image, scale=scale, alpha=alpha, free=free
    )
    _, residuals = solve(F, tol=1e-8)
    assert residuals[-1] <= 1e-8
    assert len(residuals) - 1 <= (20 if smoothness == "gradient" else 40)


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize(
    ("shape", "spacing"),
    [((33, 65), (1.0, 1.0)), ((34, 58), (1.0, 1.0)), ((64, 47), (4.0, 1.0)), ((9, 30), (1.0, 2.0))],
)
@pytest.mark.parametrize("scale", [1.0, 1e4])
def test_preconditioner_is_symmetric_and_positive(shape, spacing, smoothness, scale):
    """To rounding: single precision serves where data and smoothness are alike enough."""
    F = problem(shape, smoothness, spacing=spacing, image="bubbles", free="pixels", scale=scale)
    top = hierarchy(F)
    precision = top.x.dtype.type
    assert (precision is np.float32) == (smoothness == "gradient" and scale == 1)
    xs = np.random.default_rng(0).normal(size=(4, 2, *shape)) * F.free
    gram = [[np.vdot(top.correct(x.astype(precision))[:, 2:-2, 2:-2], y) for y in xs] for x in xs]
    atol = {np.float32: 1e-6, np.float64: 1e-10}[precision] * np.max(gram)
    np.testing.assert_allclose(gram, np.transpose(gram), atol=atol)
    assert np.linalg.eigvalsh(gram)[0] > 0


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
def test_product_is_that_of_the_matrix(smoothness):
    F = problem((23, 31), smoothness, spacing=(1.5, 0.7), free="pixels")
    u = np.random.default_rng(0).normal(size=(2, 23, 31)) * F.free
    q = np.empty_like(u)
    energy = stencils.product(q, np.pad(u, [(0, 0), (2, 2), (2, 2)]), finest(F)).sum()
    expected = F.field(F.a() @ u[:, F.free].ravel() / 2)
    np.testing.assert_allclose(q, expected, atol=1e-12 * np.abs(expected).max())
    assert energy == pytest.approx(np.vdot(u, expected))


@pytest.mark.parametrize("shape", [(33, 65), (34, 58), (41, 22)])
def test_coarse_grid_has_the_energy_of_what_it_interpolates(shape):
    """On nested grids; on others the energy may only be larger."""
    F = problem(shape, "gradient", image="bubbles", scale=1e4, free="all")
    top = hierarchy(F)
    coarse = top.coarse
    rng = np.random.default_rng(0)

    def interpolate(e, level):
        u = np.zeros_like(level.x)
        padded = np.pad(e, [(0, 0), (2, 2), (2, 2)])
        stencils.prolong(u, padded, level.operator.free, level.transfer)
        return u

    def energy(u, operator):
        """That of the pointwise term alone."""
        X1, X2 = (np.zeros_like(X) for X in operator.axes)
        X1[stencils.M], X2[stencils.M] = (X[stencils.M] for X in operator.axes)
        q = np.empty((2, *operator.shape))
        return stencils.product(q, u, operator._replace(axes=(X1, X2))).sum()

    for _ in range(5):
        e = rng.normal(size=coarse.b.shape[:1] + coarse.operator.shape)
        fine = energy(interpolate(e, top), top.operator)
        found = energy(np.pad(e, [(0, 0), (2, 2), (2, 2)]), coarse.operator)
        if all(n % 2 for n in shape):
            assert found == pytest.approx(fine, rel=1e-12)
        else:
            assert found >= fine * (1 - 1e-12)


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
def test_same_bytes_with_any_number_of_threads(smoothness):
    F = problem((301, 240), smoothness, image="bubbles")
    results, before = [], use_threads(1)
    try:
        for threads in (1, 2, 3):
            use_threads(threads)
            results.append(multigrid(F).tobytes())
    finally:
        use_threads(before)
    assert results[0] == results[1] == results[2]


def test_nothing_to_do():
    F = problem((40, 50), "gradient")
    still = Quadratic(F.grid, Pointwise(F.terms.A, 0 * F.terms.b), F.alpha, F.free)
    assert not multigrid(still).any()
    v, _ = solve(F)
    again, residuals = solve(F, initial=v, tol=2e-8)
    assert len(residuals) == 1
    np.testing.assert_array_equal(again, v)


def test_fails_honestly():
    F = problem((40, 50), "bending")
    with pytest.raises(NotConverged, match="after 2 iterations"):
        multigrid(F, max_iterations=2)


@pytest.mark.parametrize("shape", [(9, 9), (40, 50)])
@pytest.mark.parametrize(("smoothness", "free"), [("gradient", "all"), ("bending", "top")])
def test_undetermined_motions(shape, smoothness, free):
    F = problem(shape, smoothness, free="all")
    F.free[0] = free == "all"
    with pytest.raises(InputError, match="no unique minimiser"):
        multigrid(Quadratic(F.grid, Pointwise(0 * F.terms.A, F.terms.b), 1.0, F.free, smoothness))


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize("image", ["speckle", "bubbles"])
def test_a_small_change_leaves_a_smaller_error(image, smoothness):
    F = problem((60, 80), smoothness, image=image)
    exact, all_residuals = solve(F, tol=1e-12)
    for change in (1e-2, 1e-4):
        v, residuals = solve(F, change=change)
        assert 1 < len(residuals) < len(all_residuals)
        assert np.sqrt(np.mean(((v - exact) ** 2).sum(axis=0))) < 0.5 * change


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
def test_a_small_change_at_the_solution_keeps_it(smoothness):
    F = problem((40, 30), smoothness)
    exact = multigrid(F, tol=1e-12)
    v, residuals = solve(F, change=1e-3, initial=exact, tol=0.0)
    assert len(residuals) == 2
    np.testing.assert_allclose(v, exact, atol=1e-9)
    still = replace(F, terms=Pointwise(F.terms.A, 0 * F.terms.b))
    assert not multigrid(still, change=1e-3, initial=exact).any()
    with pytest.raises(NotConverged, match="last change"):
        multigrid(F, tol=0.0, change=1e-14, max_iterations=2)


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize("image", ["speckle", "bubbles"])
def test_smooth_problems_are_averaged_on_coarse_grids(image, smoothness):
    """Below a contrast, without couplings; the number of iterations does not show it."""
    iterations = {}
    for alpha in (1e2, 1e-3):
        F = problem((90, 70), smoothness, image=image, alpha=alpha, scale=0.5)
        couplings = hierarchy(F).coarse.operator.G.shape[0]
        assert couplings == (0 if alpha > 1 else 12)
        iterations[alpha] = len(solve(F)[1]) - 1
    assert iterations[1e2] <= 13
    # Pixels inside of the image that are held are stiff, whatever the contrast.
    held = problem((90, 70), smoothness, image=image, alpha=1e2, scale=0.5, free="pixels")
    assert hierarchy(held).coarse.operator.G.shape[0] == 12
