"""Radio-frequency lines: what oscillates looks alike after a motion of one period."""

import numpy as np
import pytest

import eofm
from eofm.flow.likeness import ratio_left

PERIOD = 5.0


def waves(shape, size, seed=0, count=300):
    """Speckle about a carrier along the axial direction, as a function of points."""
    random = np.random.default_rng(seed)
    k = random.normal(0, 1 / size, (len(shape), count))
    k[1] += 2 * np.pi / PERIOD
    phase = random.uniform(0, 2 * np.pi, count)
    return lambda x: sum(np.cos(np.tensordot(a, x, 1) + p) for a, p in zip(k.T, phase, strict=True))


@pytest.mark.parametrize(
    ("shape", "strain"),
    [((96, 80), 0.12), pytest.param((32, 40, 36), 0.06, marks=pytest.mark.slow)],
)
def test_motions_of_more_than_a_period_are_found(shape, strain):
    x = np.stack(np.indices(shape)[::-1]).astype(float)
    u = np.zeros_like(x)
    u[0], u[1] = -0.03 * (x[0] - x[0].mean()), 4.0 + strain * (x[1] - x[1].mean())
    image = waves(shape, 5.0)
    found = eofm.estimate_displacement(image(x + u), image(x))
    error = np.sqrt(((found.u - u) ** 2).sum(axis=0))
    assert np.abs(u[1]).max() > PERIOD
    assert error.mean() < 0.02
    assert found.trust.verdict == "good"


def test_the_field_that_leaves_less_is_told_though_one_leaves_the_image():
    image = waves((40, 60), 5.0)
    x = np.stack(np.indices((40, 60))[::-1]).astype(float)
    u = np.full((2, 40, 60), 1.5)
    I1, I2, alive = image(x + u), image(x), np.zeros((40, 60), dtype=bool)
    assert ratio_left(I1, I2, alive, u + 1, u) < 0.1
    assert ratio_left(I1, I2, alive, u, u + 1) > 10
    assert ratio_left(I1, I2, alive, u + 50, u) == 0
    assert ratio_left(I1, I2, alive, u, u + 50) == np.inf
