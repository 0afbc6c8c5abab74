"""Structures that stand still in both images while the sample moves."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import eofm
from eofm.flow.standing import Farther, Standing, standing
from eofm.flow.trust import PULLED
from eofm.imaging.splines import warp

SHAPE = (120, 150)


def speckle(shape, seed, width=1.6):
    """A texture of structures of one width, of variance 1."""
    I = gaussian_filter(np.random.default_rng(seed).normal(size=shape), width)
    return I / I.std()


def pressed(shape, mean):
    """A compression by a hundredth, with a mean displacement (lateral, axial, ...), px."""
    x = np.indices(shape)[::-1]
    sides = np.reshape(shape[::-1], (-1, *[1] * len(shape)))
    slopes = np.reshape([0.004, -0.01, 0.003][: len(shape)], sides.shape)
    return np.reshape(mean, sides.shape) + slopes * (x - sides / 2)


def pair(u, stands=0.0, seed=1, width=1.6):
    """Images of a sample before and after a displacement, with what stands still on both."""
    sample = speckle(u.shape[1:], seed, width)
    noise = 0.02 * np.random.default_rng(seed + 1).normal(size=(2, *u.shape[1:]))
    # I1 is the one that is carried along: its value at x is that of I2 at x + u(x).
    return warp(sample, u)[0] + stands + noise[0], sample + stands + noise[1]


def error(found, u, margin=8):
    inner = (slice(margin, -margin),) * (u.ndim - 1)
    return float(np.sqrt(((found.u - u) ** 2).sum(0))[inner].mean())


@pytest.mark.parametrize(("shape", "mean"), [((90, 110), (1, -2)), ((50, 53, 48), (1, -2, 0.7))])
@pytest.mark.parametrize("part", [-0.1, 0.0, 0.05])
def test_tells_how_much_farther_a_sample_has_moved(shape, mean, part):
    u = np.broadcast_to(np.reshape(mean, (-1, *[1] * len(shape))), (len(shape), *shape))
    sample = speckle(shape, 3)
    off = warp(sample, part * u)[0]
    found = standing(off, sample, np.ones(shape, dtype=bool), u / (1 + part))
    expected = part * np.linalg.norm(mean)
    # The sign: I2 at x + u / (1 + part) is the sample at less than where it has moved to.
    for structures in (found.fine, found.medium):
        assert structures.by == pytest.approx(expected, rel=0.05, abs=1e-3)
    assert (found.pull > PULLED) == (expected > 0.05)
    assert not found.way_out


@pytest.mark.parametrize("shape", [(7, 9), (20, 300), (12, 12, 12)])
def test_small_images_tell_nothing(shape):
    u = np.ones((len(shape), *shape))
    found = standing(speckle(shape, 1), speckle(shape, 2), np.ones(shape, dtype=bool), u)
    assert not found.coarse.surely(0, 1)
    assert standing(*(speckle(shape, k) for k in (1, 2)), np.zeros(shape, bool), u).pull == 0


def test_a_sample_alone_is_not_pulled():
    u = pressed(SHAPE, (0.6, -0.4))
    found = eofm.estimate_displacement(*pair(u))
    assert found.standing.pull < 0.01
    assert not found.standing.way_out
    assert found.denoising is None
    assert found.trust.verdict == "good"


@pytest.mark.parametrize("shape", [SHAPE, pytest.param((44, 48, 46), marks=pytest.mark.slow)])
def test_noise_that_comes_back_does_not_pull(shape):
    u = pressed(shape, (0.5, 0.3, -0.4)[: len(shape)])
    noise = 0.3 * np.random.default_rng(5).normal(size=shape)
    images = pair(u, noise)
    assert error(eofm.estimate_displacement(*images), u) < 0.04
    # Pulled by as much as without a way out, and said so, where a user has chosen the filter.
    plain = eofm.estimate_displacement(*images, eofm.Estimation(denoising=0.0))
    assert error(plain, u) > 0.08
    assert plain.trust.verdict == "doubtful"
    assert any("stands still" in reason for reason in plain.trust.reasons)


def test_coarse_dirt_does_not_pull():
    u = pressed(SHAPE, (4.0, 2.0))
    dirt = speckle(SHAPE, 9, 8.0)
    images = pair(u, dirt, width=1.0)
    found = eofm.estimate_displacement(*images)
    plain = eofm.estimate_displacement(*images, eofm.Estimation(denoising=0.0))
    assert error(found, u) < 0.3 * error(plain, u)


def test_error_bars_know_the_pull():
    u = pressed(SHAPE, (0.5, 0.3))
    noise = 0.15 * np.random.default_rng(5).normal(size=SHAPE)
    found = eofm.estimate_displacement(*pair(u, noise), eofm.Estimation(denoising=0.0))
    assert found.standing.pull > 0.01
    bars = np.sqrt((found.deviation(samples=24) ** 2).sum(0))
    assert np.median(bars) > 0.7 * error(found, u)


@pytest.mark.parametrize(
    ("fine", "medium", "coarse", "way"),
    [
        ((-0.1, 0.01), (0.2, 0.02), (0.2, 0.03), {"denoising": 2.0}),
        ((-0.1, 0.01), (0.2, 0.10), (0.2, 0.03), {}),  # not sure
        ((0.03, 0.001), (0.2, 0.02), (0.2, 0.03), {}),  # all are pulled: too smooth
        ((0.05, 0.01), (-0.1, 0.01), (-0.5, 0.05), {"local_window": 4.0}),
        ((0.05, 0.01), (0.05, 0.01), (0.0, 0.05), {}),
    ],
)
def test_the_way_out_is_that_of_structures_which_disagree(fine, medium, coarse, way):
    assert Standing(Farther(*fine), Farther(*medium), Farther(*coarse)).way_out == way
