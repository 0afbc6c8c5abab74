"""Motions that turn round within a few structures of the images."""

import numpy as np
import pytest

import eofm


def turned(n, degrees, width):
    """A part around the middle of an image of n x n px, of some width, that has turned."""
    x2, x1 = np.mgrid[:n, :n] - (n - 1) / 2
    angle = np.deg2rad(degrees) * np.exp(-(x1**2 + x2**2) / (2 * width**2))
    c, s = np.cos(angle) - 1, np.sin(angle)
    return np.stack([c * x1 - s * x2, s * x1 + c * x2])


@pytest.mark.parametrize(("n", "degrees", "width", "seed"), [(128, 25, 22, 1), (144, 20, 25, 3)])
def test_a_part_that_turns_is_followed(n, degrees, width, seed):
    """Coarse scales with a large weight, or a finer one that starts with it, lose it by pixels."""
    u = turned(n, degrees, width)
    speckle = eofm.Phantom(count=n * n // 20, sigma=(1.3, 1.3), seed=seed)
    found = eofm.estimate_displacement(*eofm.make_phantom(u, speckle)[:2])
    assert np.hypot(*(found.u - u)).mean() < 0.04
    assert found.trust.verdict == "good"
