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
from eofm.flow import sweeps
from eofm.flow.functional import Pointwise, Quadratic, pairs
from eofm.flow.hierarchy import LOOPS, CoarseTerms, Level, hierarchy
from eofm.flow.multigrid import NotConverged, multigrid
from eofm.flow.operator import M
from eofm.flow.sweeps import smooth
from eofm.grid import Grid, unit_spacing

SMOOTHNESS = ("gradient", "bending")


def problem(
    shape, smoothness, *, spacing=None, image="speckle", free="rows", alpha=0.1, seed=0,
    scale=1.0, speckle=0.0, precision=np.float64,
):  # fmt: skip
    """A functional with the data term of an image of a kind, and pixels fixed in a way."""
    rng, n = np.random.default_rng(seed), len(shape)
    spacing = (1.0,) * n if spacing is None else spacing
    I = rng.normal(size=shape)
    if image == "bubbles":
        I = np.where(rng.random(shape) < 20.0**-n, 30 * 3 ** (n - 2) * rng.random(shape), 0.0)
    elif image == "half":
        I[shape[0] // 2 :] = 0.0
    I = scale * gaussian_filter(I, 1.5, mode="constant")
    if image != "speckle":
        I[[0, -1]] += scale * rng.random((2, *shape[1:]))  # determines all motions
    g = np.stack(np.gradient(I, *spacing[::-1])[::-1])
    noise = 0.05 * scale * rng.normal(size=shape) * (g[0] != 0)
    I_t = 0.3 * g[0] - 0.5 * g[1] + 0.4 * sum(g[2:]) + noise
    A = np.stack([g[i] * g[j] + (speckle if i == j else 0) for i, j in pairs(n)])
    mask = np.ones(shape, dtype=bool)
    if free == "rows":
        mask[[0, -1]] = False
    elif free == "edges":
        mask[:2] = mask[..., [0, -1]] = False
    elif free == "pixels":
        mask[tuple(rng.integers(0, s, 5) for s in shape)] = False
    terms = Pointwise(A.astype(precision), (-I_t * g).astype(precision))
    return Quadratic(Grid(shape, spacing), terms, alpha, mask, smoothness)


def padded(u):
    """A field with its border of zeros."""
    return np.pad(u, [(0, 0), *[(2, 2)] * (u.ndim - 1)])


def inner(u):
    """A field without it."""
    return u[:, *[slice(2, -2)] * (u.ndim - 1)]


def solve(F, **options):
    """The solution and the residuals."""
    residuals = []
    v = multigrid(F, report=lambda _, residual: residuals.append(residual), **options)
    assert v.shape == F.terms.b.shape
    return v, residuals


KINDS = dict(
    image=st.sampled_from(["speckle", "bubbles", "half"]),
    free=st.sampled_from(["rows", "edges", "pixels", "all"]),
    alpha=st.floats(-3, 2).map(lambda e: 10**e),
    scale=st.sampled_from([1.0, 255.0]),
    speckle=st.sampled_from([0.0, 0.3]),
    smoothness=st.sampled_from(SMOOTHNESS),
    seed=st.integers(0, 99),
)
DISTANCE = st.sampled_from([0.5, 1.0, 1.7, 2.0])


@settings(max_examples=25)
@given(
    shape=st.tuples(st.integers(8, 70), st.integers(8, 70)),
    spacing=st.tuples(DISTANCE, DISTANCE),
    **KINDS,
)
def test_agrees_with_the_direct_solver(shape, smoothness, **kind):
    F = problem(shape, smoothness, **kind)
    u, (v, _) = direct(F), solve(F, tol=1e-12)
    assert np.abs(v - u).max() <= 1e-7 * np.abs(u).max()
    assert (v[:, ~F.free] == 0).all()


@settings(max_examples=12)
@given(
    shape=st.tuples(st.integers(6, 14), st.integers(6, 17), st.integers(6, 17)),
    spacing=st.tuples(DISTANCE, DISTANCE, DISTANCE),
    **KINDS,
)
def test_agrees_with_the_direct_solver_in_volumes(shape, smoothness, **kind):
    test_agrees_with_the_direct_solver.hypothesis.inner_test(shape, smoothness, **kind)


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
    [
        ((33, 65), (1.0, 1.0)),
        ((34, 58), (1.0, 1.0)),
        ((64, 47), (4.0, 1.0)),
        ((9, 30), (1.0, 2.0)),
        ((17, 9, 13), (1.0, 1.0, 1.0)),
        ((12, 16, 21), (1.0, 1.0, 3.0)),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 1e4])
def test_preconditioner_is_symmetric_and_positive(shape, spacing, smoothness, scale):
    """To rounding: single precision serves where data and smoothness are alike enough."""
    F = problem(shape, smoothness, spacing=spacing, image="bubbles", free="pixels", scale=scale)
    top = hierarchy(F)
    precision = top.x.dtype.type
    assert (precision is np.float32) == (smoothness == "gradient" and scale == 1)
    xs = np.random.default_rng(0).normal(size=(4, *F.terms.b.shape)) * F.free
    gram = [[np.vdot(inner(top.correct(x.astype(precision))), y) for y in xs] for x in xs]
    atol = {np.float32: 1e-6, np.float64: 1e-10}[precision] * np.max(gram)
    np.testing.assert_allclose(gram, np.transpose(gram), atol=atol)
    assert np.linalg.eigvalsh(gram)[0] > 0


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
# Volumes of rows that go together, of longer ones, and of such that are cut into blocks.
@pytest.mark.parametrize(
    "shape", [(23, 31), (7, 9, 12), (4, 40, 9), (4, 3, 300), (4, 6, 130), (4, 3, 600)]
)
def test_product_is_that_of_the_matrix(shape, smoothness):
    F = problem(shape, smoothness, spacing=(1.5, 0.7, 1.1)[: len(shape)], free="pixels")
    u = np.random.default_rng(0).normal(size=F.terms.b.shape) * F.free
    q = np.empty_like(u)
    energy = LOOPS[len(shape)].product(q, padded(u), F.operator()).sum()
    expected = F.field(F.a() @ u[:, F.free].ravel() / 2)
    np.testing.assert_allclose(q, expected, atol=1e-12 * np.abs(expected).max())
    assert energy == pytest.approx(np.vdot(u, expected))


@pytest.mark.parametrize(
    "shape",
    [
        (33, 65), (34, 58), (41, 22), (17, 25, 33), (16, 19, 26), (33, 9, 12), (9, 65, 17),
        (9, 9, 1045),
    ],
)  # fmt: skip
def test_coarse_grid_has_the_energy_of_what_it_interpolates(shape):
    """On nested grids; on others the energy may only be larger."""
    F = problem(shape, "gradient", image="bubbles", scale=1e4, free="all")
    top = hierarchy(F)
    coarse, loops = top.coarse, LOOPS[len(shape)]
    rng = np.random.default_rng(0)

    def energy(u, operator):
        """That of the pointwise term alone."""
        axes = tuple(np.zeros_like(X) for X in operator.axes)
        for X, own in zip(axes, operator.axes, strict=True):
            X[M] = own[M]
        q = np.empty(inner(u).shape)
        return loops.product(q, u, operator._replace(axes=axes)).sum()

    levels = [(top, coarse)]
    if isinstance(coarse.coarse, Level):
        levels.append((coarse, coarse.coarse))
    for level, below in levels:
        for _ in range(3):
            e = padded(rng.normal(size=level.b.shape))
            u = np.zeros_like(level.x)
            loops.prolong(u, e, level.operator.free, level.transfer)
            fine, found = energy(u, level.operator), energy(e, below.operator)
            if all(n % 2 for n in level.operator.shape):
                assert found == pytest.approx(fine, rel=1e-12)
            else:
                assert found >= fine * (1 - 1e-12)


@pytest.mark.parametrize("shape", [(33, 65), (34, 58), (17, 13, 33), (16, 19, 26)])
def test_restriction_is_the_transpose_of_the_interpolation(shape):
    top = hierarchy(problem(shape, "bending", free="edges"))
    loops, rng = LOOPS[len(shape)], np.random.default_rng(0)
    b, e = rng.normal(size=inner(top.x).shape), rng.normal(size=top.b.shape)
    u, nothing = np.zeros_like(top.x), np.zeros_like(top.x)
    loops.prolong(u, padded(e), top.operator.free, top.transfer)
    loops.restrict(top.b, b, nothing, top.transfer, top.operator)
    assert np.vdot(inner(u), b) == pytest.approx(np.vdot(e, top.b), rel=1e-12)
    assert (inner(u)[:, ~top.operator.free] == 0).all()
    constant = padded(np.ones_like(e))
    loops.prolong(nothing, constant, top.operator.free, top.transfer)
    np.testing.assert_allclose(inner(nothing)[:, top.operator.free], 1, rtol=1e-14)


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize("shape", [(23, 31), (9, 11, 13)])
def test_smoother_is_bounded(shape, smoothness):
    """``K <= D``: no step from zero of an eigenvector of D^-1 K goes beyond its solution."""
    F = problem(shape, smoothness, image="bubbles", free="pixels", scale=30.0)
    loops, K = LOOPS[len(shape)], F.operator()
    rng = np.random.default_rng(0)
    x = padded(rng.normal(size=F.terms.b.shape) * F.free)
    q, y = np.empty_like(F.terms.b), np.zeros_like(x)
    for _ in range(60):  # power iteration with D^-1 K
        loops.product(q, x, K)
        y, _ = smooth(loops.sweep, np.zeros_like(x), y, q, range(1, 2), True, K)
        y *= 3 / 4  # the weight of the first step
        largest = np.linalg.norm(y) / np.linalg.norm(x)
        x = y / np.linalg.norm(y)
    assert 0.4 < largest <= 1


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize(
    ("shape", "precision"), [((301, 240), np.float64), ((40, 57, 45), np.float32)]
)
def test_same_bytes_with_any_number_of_threads(shape, precision, smoothness):
    F = problem(shape, smoothness, image="bubbles", precision=precision)
    results = []
    for threads in (1, 2, 3):
        use_threads(threads)
        results.append(multigrid(F).tobytes())
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("shape", [(40, 50), (17, 20, 18)])
def test_nothing_to_do(shape):
    F = problem(shape, "gradient")
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


@pytest.mark.parametrize("precision", [np.float64, np.float32])
@pytest.mark.parametrize("shape", [(9, 9), (40, 50), (9, 12, 10)])
@pytest.mark.parametrize(("smoothness", "free"), [("gradient", "all"), ("bending", "top")])
def test_undetermined_motions(shape, smoothness, free, precision):
    F = problem(shape, smoothness, free="all", precision=precision)
    F.free[0] = free == "all"
    still = replace(F, terms=Pointwise(0 * F.terms.A, F.terms.b))
    with pytest.raises(InputError, match="no unique minimiser"):
        multigrid(still)
    # Images that tell one component only.
    A = F.terms.A[:1] * (np.arange(len(F.terms.A)) == 0).reshape(-1, *[1] * len(shape))
    with pytest.raises(InputError, match="no unique minimiser"):
        multigrid(replace(F, terms=Pointwise(A.astype(precision), F.terms.b)))
    # An edge that is held, and one pixel beside it for bending, leaves nothing.
    F.free[0] = False
    F.free[-1, -1] = smoothness == "gradient"
    assert multigrid(replace(still, free=F.free)).shape == F.terms.b.shape


@pytest.mark.parametrize(("pixels", "said"), [(0, "hardly any pixel"), (6, "only 0.3% of")])
def test_where_hardly_a_pixel_carries_data_a_mask_may_be_inverted(pixels, said):
    F = problem((40, 50), "bending", free="all")
    A = np.zeros_like(F.terms.A)
    A[:, 20, 20 : 20 + pixels] = F.terms.A[:, 20, 20 : 20 + pixels]
    with pytest.raises(InputError, match=f"{said}.* data; is the mask the wrong way round"):
        multigrid(replace(F, terms=Pointwise(A, F.terms.b)))


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize("image", ["speckle", "bubbles"])
@pytest.mark.parametrize("shape", [(60, 80), (24, 20, 26)])
def test_a_small_change_leaves_a_smaller_error(shape, image, smoothness):
    F = problem(shape, smoothness, image=image)
    exact, all_residuals = solve(F, tol=1e-12)
    for change in (1e-2, 1e-4):
        v, residuals = solve(F, change=change)
        assert 1 < len(residuals) < len(all_residuals)
        assert np.sqrt(np.mean(((v - exact) ** 2).sum(axis=0))) < 0.5 * change


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize("shape", [(40, 30), (12, 17, 14)])
def test_a_small_change_at_the_solution_keeps_it(shape, smoothness):
    F = problem(shape, smoothness)
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


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize(("image", "scale"), [("speckle", 1.0), ("bubbles", 1.0), ("half", 255.0)])
@pytest.mark.parametrize("alpha", [1e-2, 1.0, 1e2])
def test_few_iterations_in_volumes(smoothness, image, scale, alpha):
    F = problem((32, 32, 32), smoothness, image=image, scale=scale, alpha=alpha)
    _, residuals = solve(F, tol=1e-8)
    assert len(residuals) - 1 <= (15 if scale == 1 else 20)


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize(
    ("shape", "spacing"),
    [
        ((6, 40, 50), (1.0, 1.0, 1.0)),
        ((37, 20, 26), (1.0, 1.0, 1.0)),
        ((20, 30, 24), (1.0, 1.0, 4.0)),
        ((25, 22, 18), (3.0, 1.0, 2.0)),
    ],
)
@pytest.mark.parametrize(("alpha", "free"), [(1e-3, "all"), (0.3, "pixels"), (100.0, "edges")])
def test_volumes_of_all_shapes(shape, spacing, smoothness, alpha, free):
    F = problem(shape, smoothness, spacing=spacing, image="bubbles", alpha=alpha, free=free)
    _, residuals = solve(F, tol=1e-8)
    assert len(residuals) - 1 <= (20 if smoothness == "gradient" else 40)


@pytest.mark.parametrize("sides", [(3, 3, 3), (3, 3, 20), (10, 3, 10), (4, 3, 8), (3, 20, 3)])
@pytest.mark.parametrize("reach", [1.0, 4.0])
def test_flat_voxels_take_the_work_of_cubes(sides, reach):
    """Iterations, and the nodes of all grids as often as a cycle visits them."""
    shape, spacing = (37, 50, 52), unit_spacing(sides)
    F = problem(shape, "bending", spacing=spacing, free="all")
    strength = np.mean([F.terms.A[k] for k in (0, 3, 5)])
    F = replace(F, alpha=strength * reach**4)
    top = level = hierarchy(F)
    nodes, visits = 0, 1
    while isinstance(level, Level):
        nodes += visits * level.operator.free.size
        visits, level = visits * level.visits, level.coarse
    assert nodes < 2.5 * F.free.size
    _, residuals = solve(F, tol=1e-8, levels=top)
    assert len(residuals) - 1 <= 17


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize("image", ["speckle", "bubbles"])
def test_single_precision_gives_the_same_field(image, smoothness):
    """Sums of products are in double precision: what is left is the rounding of the field."""
    F = problem((24, 40, 33), smoothness, image=image, alpha=10.0)
    exact = multigrid(F, tol=1e-12)
    single = Pointwise(F.terms.A.astype(np.float32), F.terms.b.astype(np.float32))
    v, _ = solve(replace(F, terms=single), tol=1e-8)
    assert v.dtype == np.float32
    # The terms themselves are rounded.
    assert np.abs(v - exact).max() <= 1e-5 * np.abs(exact).max()


@pytest.mark.parametrize("smoothness", SMOOTHNESS)
@pytest.mark.parametrize(
    "shape", [(140, 61), (41, 300), (9, 8), (70, 67, 20), (37, 9, 300), (9, 70, 12)]
)
@pytest.mark.parametrize("from_zero", [True, False])
def test_steps_that_go_together_are_those_one_by_one(shape, smoothness, from_zero, monkeypatch):
    """In every byte, wherever slabs, strips and blocks end."""
    F = problem(shape, smoothness, free="pixels", precision=np.float32)
    K = F.operator().rounded(np.float32)
    b = F.terms.b * F.free
    for degree in (1, 3, 4, 6):
        results = []
        for together in (1, 4):
            monkeypatch.setattr(sweeps, "TOGETHER", together)
            fields = padded(0.1 * b), padded(0.2 * b)
            sweep = LOOPS[len(shape)].sweep
            results.append(smooth(sweep, *fields, b, range(1, degree + 1), from_zero, K))
        for one_by_one, at_once in zip(*results, strict=True):
            np.testing.assert_array_equal(at_once, one_by_one)


@pytest.mark.parametrize("free", ["all", "rows"])
@pytest.mark.parametrize("shape", [(21, 33), (9, 14, 17)])
def test_coarse_terms_serve_any_weight(shape, free, rng):
    """One hierarchy after the other, of few couplings and of many, corrects as by itself."""
    known, F = CoarseTerms(), problem(shape, "bending", free=free)
    for alpha in (1e3, 1e-2, 30.0, 1e-2):
        G = replace(F, alpha=alpha)
        b = rng.normal(size=(len(shape), *shape)).astype(G.operator().A.dtype)
        alone, shared = hierarchy(G), hierarchy(G, known)
        assert (alone.correct(b) == shared.correct(b)).all()
