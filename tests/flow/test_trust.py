"""What a verdict says of right and wrong fields, whatever made them."""

import numpy as np
import pytest
from conftest import speckle
from hypothesis import given
from hypothesis import strategies as st

import eofm
from eofm.flow.trust import folds, judge
from eofm.flow.windows import correlate
from eofm.imaging.splines import evaluate, warp

SHAPE = (120, 152)


@pytest.fixture(scope="module")
def moved():
    """Dense speckle and a smooth motion of up to 4 px."""
    x2, x1 = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    u = np.stack([2 * np.sin(x1 / 50) + 1, -4 * x2 / SHAPE[0]])
    big = speckle((SHAPE[0] + 40, SHAPE[1] + 40), np.random.default_rng(1))
    I1 = evaluate(big, np.stack([x1, x2]) + u + 20)
    return I1, big[20:-20, 20:-20], u


def verdict(I1, I2, u, **more):
    return judge(I1, *warp(I2, u), u, **more)


def test_a_right_field_is_good_whatever_happens_to_the_brightness(moved, rng):
    I1, I2, u = moved
    depth = np.linspace(0, 1, SHAPE[0])[:, None]
    for image in (I2, 0.3 + 0.2 * I2, I2**2, I2 * (1 - 0.8 * depth) + 0.5 * depth):
        trust = verdict(I1, image, u)
        assert (trust.verdict, trust.reasons) == ("good", ())
    noise = rng.normal(0, 0.05, SHAPE)
    assert verdict(I1, I2 + noise, u).verdict == "good"


@pytest.mark.parametrize("wrong", [3.0, 5.0, 20.0])
def test_a_field_that_is_off_by_pixels_has_failed(moved, wrong):
    I1, I2, u = moved
    trust = verdict(I1, I2, u + wrong)
    assert trust.verdict == "failed"
    assert "match the other one" in trust.reasons[0]
    assert np.nanmedian(trust.map) < 0.2


@pytest.mark.parametrize("wrong", [0.7, 1.0])
def test_a_field_that_is_off_by_a_pixel_is_doubtful(moved, wrong):
    I1, I2, u = moved
    trust = verdict(I1, I2, u + [[[wrong]], [[0]]])
    assert trust.verdict == "doubtful"
    assert trust.drift == pytest.approx(wrong, abs=0.1)


def test_a_part_that_is_off_is_told_and_shown(moved):
    I1, I2, u = moved
    wrong = u.copy()
    wrong[:, 70:, 90:] += 4
    trust = verdict(I1, I2, wrong)
    assert trust.verdict == "doubtful"
    assert np.nanmean(trust.map[90:, 110:]) < 0.3 < 0.9 < np.nanmean(trust.map[:50, :60])


@given(st.integers(0, 1000))
def test_images_that_have_nothing_in_common_fail(seed):
    rng = np.random.default_rng(seed)
    I1, I2 = (speckle((96, 100), rng, 1.2) for _ in range(2))
    assert judge(I1, I2, np.ones(I1.shape, dtype=bool), np.zeros((2, 96, 100))).verdict == "failed"


def test_identical_images_and_folds_and_masks_are_told(moved):
    I1, _, u = moved
    used = np.ones(SHAPE, dtype=bool)
    assert "both images are the same" in judge(I1, I1, used, 0 * u).reasons[0]
    few = np.zeros(SHAPE, dtype=bool)
    few[:40, :40] = True
    assert "9% of the image carry data" in judge(I1, I1, few, u).reasons[0]
    assert "no part of the image" in judge(I1, I1, ~used, u).reasons[0]
    x1 = np.mgrid[: SHAPE[0], : SHAPE[1]][1].astype(float)
    turned = np.stack([np.where(x1 > 75, -1.5 * (x1 - 75), 0), 0 * x1])
    assert folds(turned) == pytest.approx(0.5, abs=0.02)
    assert folds(u) == 0
    assert "folds" in "".join(judge(I1, I1, used, turned).reasons)


def test_the_peaks_stand_at_the_true_offset(moved):
    _, I2, _ = moved
    shift = np.stack([np.full(SHAPE, 0.4), np.full(SHAPE, -0.7)])
    shifted, used = warp(I2, -shift)
    windows = correlate(I2, shifted, used)
    inner = windows.offset[:, 1:-1, 1:-1]
    np.testing.assert_allclose(np.median(inner, axis=(1, 2)), [0.4, -0.7], atol=0.05)


def test_estimates_carry_their_verdict(moved):
    I1, I2, _ = moved
    good = eofm.estimate_displacement(I1, I2).trust
    assert good.verdict == "good"
    assert good.map.shape == SHAPE
    assert good.summary()["agreeing"] == 1.0
    failed = eofm.estimate_displacement(I1, np.flipud(I2)).trust
    assert failed.verdict == "failed"


@pytest.mark.parametrize("shape", [(8, 8), (9, 40), (33, 17), (64, 65)])
def test_sizes(shape, rng):
    I = speckle(shape, rng, 1.0)
    trust = judge(I, I, np.ones(shape, dtype=bool), np.full((2, *shape), 1e-3))
    assert trust.map.shape == shape
    assert trust.agreeing == 1


@pytest.mark.parametrize("alpha", [None, 0.1, 0.01])
def test_a_field_that_follows_noise_is_doubtful(moved, rng, alpha):
    """Windows agree all the same, for it has done its best to make them alike."""
    I1, I2, u = moved
    noisy = (I + rng.normal(0, 0.05, SHAPE) for I in (I1, I2))
    found = eofm.estimate_displacement(*noisy, eofm.Estimation(alpha=alpha))
    bars = np.median(np.hypot(*found.deviation(8)))
    assert 0.8 * bars < found.spread < 2.5 * bars
    follows = alpha == 0.01
    assert (np.hypot(*(found.u - u)).mean() > 0.2) == follows
    assert any("leave the motion open" in reason for reason in found.trust.reasons) == follows


@pytest.mark.parametrize(("dark", "expected"), [(0.2, "good"), (0.7, "doubtful")])
def test_noise_around_a_sample_does_not_fail_it(moved, rng, dark, expected):
    _, I2, u = moved
    bright = I2.std()
    I2 = I2 * (np.arange(SHAPE[0]) >= dark * SHAPE[0])[:, None]
    images = [I + 0.05 * bright * rng.normal(size=SHAPE) for I in (warp(I2, u)[0], I2)]
    trust = verdict(*images, u)
    assert trust.verdict == expected
    assert trust.agreeing > 0.9
    assert trust.empty == pytest.approx(dark, abs=0.2)
    assert (expected == "good") != any("nothing but noise" in reason for reason in trust.reasons)
    # A sample that does not match fails as before.
    assert verdict(*images, u + 5.0).verdict == "failed"
