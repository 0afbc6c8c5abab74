"""The choice of the weight, and the accurate estimate that rests on it."""

import numpy as np
import pytest

import eofm.flow.estimate
import eofm.flow.weight
from eofm.flow.estimate import estimate_displacement
from eofm.flow.functional import Quadratic
from eofm.flow.known import Known
from eofm.flow.matching import Match, held_out
from eofm.flow.multigrid import multigrid
from eofm.flow.pair import ImagePair
from eofm.flow.parts import drawn
from eofm.flow.roughness import ease, squared_bending
from eofm.flow.trial import STIFFEST, first_alpha
from eofm.flow.weight import choose_alpha
from eofm.grid import Grid
from eofm.imaging.gaussian import blur
from eofm.imaging.splines import warp
from eofm.settings import Estimation, Phantom
from eofm.simulation.phantom import make_phantom

SHAPE = (40, 56)


def smooth_field(shape=SHAPE, size=1.5):
    x2, x1 = np.mgrid[: shape[0], : shape[1]] / np.reshape(shape, (2, 1, 1))
    return size * np.stack([0.6 * (x1 - 0.5) * np.sin(np.pi * x2), -x2 + 0.1 * np.sin(4 * x1)])


def speckle(u, **changes):
    settings = {"count": 400, "sigma": (1.3, 1.3), "seed": 3} | changes
    return make_phantom(u, Phantom(**settings))[:2]


def relative(estimate, truth):
    return np.linalg.norm(estimate - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize("block", [8, 16])
def test_held_out_blocks_are_a_quarter_and_disjoint(block):
    folds = np.stack([held_out((128, 192), k, block) for k in range(4)])
    assert (folds.sum(0) == 1).all()
    assert np.allclose(folds.mean((1, 2)), 0.25, atol=0.02)


def test_no_motion_gives_zero():
    I = speckle(np.zeros((2, *SHAPE)))[0]
    assert np.abs(estimate_displacement(I, I).u).max() < 1e-9


def test_motion_is_found_without_edges_or_background():
    u = smooth_field()
    found = estimate_displacement(*speckle(u))
    assert relative(found.u, u) < 0.06
    assert np.array_equal(found.u, estimate_displacement(*speckle(u)).u)


def test_an_exact_background_stays():
    u = smooth_field()
    edges = ("top", "bottom", "left", "right")
    found = estimate_displacement(
        *speckle(u), Estimation(zero_edges=edges), known=Known(background=u)
    )
    assert relative(found.u, u) < 0.01
    assert np.array_equal(found.u[:, 0], u[:, 0])


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
def test_the_weight_chosen_is_near_the_best(noise):
    u = smooth_field()
    images = speckle(u, count=1500, noise=noise)
    weights = 10.0 ** np.arange(-2, 2.5, 0.5)
    errors = [relative(estimate_displacement(*images, Estimation(alpha=a)).u, u) for a in weights]
    assert relative(estimate_displacement(*images).u, u) < 1.25 * min(errors)


@pytest.mark.parametrize("wavelength", [40, 60])
def test_motion_that_varies_within_some_speckles_is_found(wavelength):
    """Weights that smooth it away are a minimum of the misfit too."""
    x2, x1 = np.mgrid[:160, :150]
    u = np.stack([1.2 * np.sin(2 * np.pi * x2 / wavelength), np.cos(2 * np.pi * x1 / wavelength)])
    found = estimate_displacement(*speckle(u, count=2400, noise=0.02))
    assert relative(found.u, u) < 0.1
    assert found.trust.verdict == "good"


@pytest.mark.parametrize("shape", [(14, 24, 28), (96, 128)])
def test_motion_is_not_made_affine_where_all_large_weights_are_as_good(shape):
    """The search begins where the misfit does not depend on the weight."""
    *_, x2, x1 = np.mgrid[tuple(slice(n) for n in shape)]
    waves = 0.3 * np.sin(x2 / 5), 0.3 * np.cos(x1 / 6), 0.3 * np.sin(x2 / 7)
    u = np.stack(waves[: len(shape)])
    found = estimate_displacement(*speckle(u, count=u[0].size // 15, noise=0.02, seed=1))
    assert relative(found.u, u) < 0.2


def test_weights_of_volumes_end_where_rounding_would_outweigh_the_images():
    """Single precision cannot tell an affine motion from others there, and solves diverge."""
    rng, shape = np.random.default_rng(0), (25, 21, 29)
    u, free = np.zeros((3, *shape), np.float32), np.ones(shape, dtype=bool)
    g, r = (rng.normal(size=f.shape).astype(np.float32) for f in (u, u[0]))
    match = Match(Grid(shape), u, g, r, free)
    first = first_alpha(match)
    start = 3.0**8 * first
    for before in ((), (start,)):
        best, alpha, *_ = choose_alpha(match, u, u, free, start, before)
        assert 0 < best <= alpha <= 1.001 * STIFFEST * first


def test_a_larger_weight_of_coarser_scales_counts_as_far_as_the_misfit_allows():
    u = smooth_field()
    I1, I2 = speckle(u, count=1500, noise=0.1)
    shape = u.shape[1:]
    free, zero = np.ones(shape, dtype=bool), np.zeros_like(u)
    match = ImagePair(Grid(shape), I1, I2, free, free, True).linearise(u)
    best, alone = choose_alpha(match, zero, zero, free, 1.0)[:2]
    assert alone == best
    used = choose_alpha(match, zero, zero, free, 1.0, (2 * best,)).alpha
    assert used == pytest.approx(np.sqrt(2) * best)
    used = choose_alpha(match, zero, zero, free, 1.0, (1e8 * best,)).alpha
    assert best <= used < 1e3 * best


def test_windows_stand_for_a_large_image():
    """More pixels to the same weight: its order of magnitude does not depend on windows."""
    shape = (400, 420)
    u = smooth_field(shape, 3.0)
    I1, I2 = speckle(u, count=12000, noise=0.1)
    free, zero = np.ones(shape, dtype=bool), np.zeros((2, *shape))
    match = ImagePair(Grid(shape), I1, I2, free, free, True).linearise(u)
    chosen = choose_alpha(match, zero, zero, free, 1.0).best
    part = np.s_[:300, :300]
    match = ImagePair(Grid((300, 300)), I1[part], I2[part], free[part], free[part], True).linearise(
        u[:, *part]
    )
    zero = zero[:, *part]
    assert 0.1 < chosen / choose_alpha(match, zero, zero, free[part], 1.0).best < 10


def test_places_drawn_count_as_all_of_them():
    """The mean over many draws of weighed sums is the sum: each draw is a shift of the shares."""
    rng = np.random.default_rng(0)
    share = rng.uniform(0.2, 1, (4, 6))
    share /= share.sum()
    picked = drawn(share, 5)
    assert all(np.isclose(count * 5 * share[k], round(count * 5 * share[k])) for k, count in picked)
    assert np.isclose(sum(count * share[k] for k, count in picked), 1)
    even = drawn(np.full((4, 6), 1 / 24), 24)
    assert sorted(k for k, _ in even) == list(np.ndindex(4, 6))
    assert np.allclose([count for _, count in even], 1)
    sure = drawn(np.where(np.arange(24).reshape(4, 6) == 7, 1 - 23e-6, 1e-6), 5)
    assert [k for k, _ in sure] == [(1, 1)]
    assert sure[0][1] == pytest.approx(1, rel=1e-3)


def test_a_motion_that_is_rough_in_one_place_is_not_missed():
    """A shear band of a large image that lies in none of its quarters' middles."""
    shape = (512, 512)
    x2, x1 = np.mgrid[: shape[0], : shape[1]]
    u = np.stack([0.002 * x2, 1.0 * np.tanh((x1 - 256) / 6)])
    images = speckle(u, count=22000, sigma=(1.5, 1.5), noise=0.01)
    found = estimate_displacement(*images)
    errors = {
        alpha: np.sqrt(
            ((estimate_displacement(*images, Estimation(alpha=alpha)).u - u) ** 2).mean()
        )
        for alpha in (0.03, 0.3, 3.0)
    }
    assert np.sqrt(((found.u - u) ** 2).mean()) < 1.15 * min(errors.values())


def test_a_black_quarter_does_not_stop_the_choice():
    shape = (400, 400)
    u = smooth_field(shape, 2.0)
    I1, I2 = speckle(u, count=9000, noise=0.0)
    I1[:200, :200] = I2[:200, :200] = 0
    found = estimate_displacement(I1, I2, Estimation(scales=2, warps=2))
    assert relative(found.u[:, 220:, 220:], u[:, 220:, 220:]) < 0.05


def test_smoothing_is_eased_where_motion_is_rough():
    """The edge of a disc that is strained: less error than with any one weight."""
    shape = (160, 200)
    x2, x1 = np.mgrid[: shape[0], : shape[1]] - np.array([70.0, 90.0]).reshape(2, 1, 1)
    u = 0.04 * np.stack([x1, x2]) * np.minimum(1, 30.0**2 / np.maximum(x1**2 + x2**2, 1))
    images = speckle(u, count=3000, sigma=(1.5, 1.5), noise=0.02)

    def error(settings):
        return np.sqrt(((estimate_displacement(*images, settings).u - u) ** 2).mean())

    one = [error(Estimation(alpha=a, robust=False)) for a in 10.0 ** np.arange(-1, 2.5, 0.5)]
    found = estimate_displacement(*images)
    assert error(Estimation()) < 0.9 * min(one)
    edge = np.abs(np.hypot(x1, x2) - 30) < 4
    assert found.weight[edge].mean() < 0.3 * found.weight[~edge].mean()


def sliding(shape, width, noise, seed):
    """Halves that slide along each other: the displacement, and images of some structures."""
    x2, _ = np.mgrid[: shape[0], : shape[1]] - 0.55 * shape[0]
    u = np.stack([np.where(x2 < 0, 1.0, -1.0), -0.01 * x2])
    rng = np.random.default_rng(seed)
    I = blur(rng.normal(size=shape), width)
    added = noise * I.std() * rng.normal(size=(2, *shape))
    return u, (warp(I, u)[0] + added[0], I + added[1])


def test_a_weight_that_varies_may_have_to_be_less(monkeypatch):
    u, images = sliding((120, 150), 4.0, 0.01, 2)
    found = estimate_displacement(*images)
    monkeypatch.setattr(eofm.flow.weight, "EASIER", (0,))
    even = estimate_displacement(*images)
    assert even.ease is None
    assert found.ease is not None
    less, much = (np.hypot(*(f.u - u)).mean() for f in (found, even))
    assert less < 0.96 * much


def test_images_of_one_gain_keep_where_smoothing_is_eased(monkeypatch):
    """A weight that is small beside the line alone follows noise elsewhere."""
    u, images = sliding((120, 150), 2.0, 0.03, 1)
    usual = estimate_displacement(*images)
    monkeypatch.setattr(eofm.flow.estimate, "BETTER", np.inf)
    found = estimate_displacement(*images)
    assert (usual.pair.even, found.pair.even) == (False, True)
    far = np.abs(np.arange(120) - 66) > 16
    error, before = (np.hypot(*(f.u - u))[far].mean() for f in (found, usual))
    assert found.ease is not None
    assert error < 1.2 * before


def test_ease_is_one_where_nothing_is_rough_and_follows_a_kink():
    grid, seen = Grid(SHAPE), np.ones(SHAPE)
    assert (ease(np.zeros((2, *SHAPE)), grid, seen, 4.0) == 1).all()
    x = np.arange(SHAPE[1]) - 28.0
    kink = np.broadcast_to(0.01 * np.abs(x), (2, *SHAPE))
    factor = ease(kink, grid, seen, 1.0)
    assert (factor.argmax(1) == 28).all()
    assert 1 < factor.max() < 3
    assert np.allclose(ease(5 * kink, grid, seen, 1.0), factor, rtol=0.01)
    parabola = np.broadcast_to(0.01 * x**2, (2, *SHAPE))
    assert np.allclose(squared_bending(parabola, grid, 0.5)[:, 5:-5], 2 * 0.02**2)


def test_noise_that_a_weight_smooths_over_hides_no_bump(rng):
    """And an affine motion is rough nowhere, not at the edges either."""
    shape = (120, 160)
    grid, seen = Grid(shape), np.ones(shape)
    x2, x1 = np.mgrid[: shape[0], : shape[1]] - np.reshape((50.0, 90.0), (2, 1, 1))
    noise = np.stack([blur(rng.normal(size=shape), 3.0) for _ in range(2)])
    field = np.exp(-(x1**2 + x2**2) / 200) + 0.1 * noise / noise.std()
    within = np.hypot(x1, x2) < 10
    near, reached = (
        f[within].mean() / f[~within].mean() for f in (ease(field, grid, seen, r) for r in (0.2, 3))
    )
    assert reached > 2 * near > 2
    assert np.allclose(ease(np.stack([0.04 * x1, -0.02 * x2]), grid, seen, 4.0), 1)


def test_a_factor_is_a_weight_that_varies_but_for_its_derivatives():
    """With a constant one the minimiser is that of the weight divided by it."""
    u = smooth_field()
    I1, I2 = speckle(u)
    free, zero = np.ones(SHAPE, dtype=bool), np.zeros((2, *SHAPE))
    match = ImagePair(Grid(SHAPE), I1, I2, free, free, True).linearise(u)

    def minimiser(match, alpha):
        return multigrid(Quadratic(Grid(SHAPE), match.density(zero), alpha, free, "bending"))

    assert np.allclose(
        minimiser(match.eased(np.full(SHAPE, 4.0)), 2.0), minimiser(match, 0.5), atol=1e-6
    )


@pytest.mark.parametrize("seed", [1, 3])
def test_coarse_speckle_that_decorrelates_does_not_look_like_motion(seed):
    """Blocks narrower than it are told by what is around them, whatever field explains that."""
    rng, (n, m) = np.random.default_rng(seed), (144, 168)
    x2, x1 = np.mgrid[:n, :m].astype(float)
    u = np.stack([0.02 * (x1 - m / 2), -0.05 * x2])
    x, y = (rng.uniform(-30, side + 30, 1395) for side in (m, n))
    strength, images = rng.normal(size=x.size), []
    for moved in (0.0, 1.0):
        there = x + moved * 0.02 * (x - m / 2), y - moved * 0.05 * y
        across = np.exp(-(((np.arange(m)[:, None] - there[0]) / 9) ** 2) / 2)
        along = np.exp(-(((np.arange(n)[:, None] - there[1]) / 7) ** 2) / 2)
        echo = abs((along * strength) @ across.T)
        images.append(echo / echo.std() + 0.03 * rng.normal(size=(n, m)))
    found = estimate_displacement(*images)
    assert np.hypot(*(found.u - u)).mean() < 0.06
