"""One grey scale from windows of volumes: that of the whole."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from eofm.errors import InputError
from eofm.imaging.defects import defects, filled
from eofm.imaging.greys import Greys, grown
from eofm.imaging.intensity import normalise
from eofm.io import windows

SHAPE = (30, 40, 36)


def volumes(seed=0, lights=0, line=False, impulses=0, width=1.0):
    rng = np.random.default_rng(seed)
    pair = [(100 + 50 * gaussian_filter(rng.rayleigh(size=SHAPE), width)) for _ in range(2)]
    pair = [I.astype(np.float32) for I in pair]
    for at in rng.integers(4, 26, (lights, 3)):
        i, j, k = at
        # A flat one among large structures, a point among small ones.
        pair[0][i, j, k : k + int(width)] = 5200
    pair[0][tuple(rng.integers(0, 30, (3, impulses)))] = 0
    if line:
        pair[1][12, 3:, 20] = 1000
    return pair


def whole(pair):
    J = normalise(*pair)
    dead = [defects(j) for j in J]
    return normalise(*(filled(I, d) for I, d in zip(pair, dead, strict=True))), dead


@pytest.mark.parametrize(
    ("lights", "line", "impulses", "width"),
    [
        *((0, False, 0, 1.0), (5, False, 0, 1.0), (5, True, 0, 1.0), (0, True, 0, 1.0)),
        *((0, False, 40, 1.0), (5, True, 40, 1.0), (5, True, 0, 4.0), (60, False, 0, 4.0)),
    ],
)
def test_windows_have_the_grey_scale_of_the_whole(lights, line, impulses, width):
    pair = volumes(lights=lights, line=line, impulses=impulses, width=width)

    def raw(k, window):
        return pair[k][window]

    greys = Greys.of(raw, SHAPE, 5000, robust=True)
    assert Greys.parse(json.loads(json.dumps(greys.summary()))) == greys
    expected, dead = whole(pair)

    def marked(k, window):
        return greys.dead(raw, k, window, SHAPE)

    assert any(d.any() for d in dead) == (lights > 0 or line or impulses > 0)
    for k in (0, 1):
        for window in windows(SHAPE, 9000):
            I, live = greys.read(raw, marked, k, window, SHAPE)
            np.testing.assert_array_equal(live, ~dead[k][window])
            # What is filled in is that of one of several nearest pixels.
            np.testing.assert_allclose(I[live], expected[k][window][live], atol=1e-6)


def test_limits_that_are_said():
    pair = volumes(lights=3)
    greys = Greys.of(lambda k, w: pair[k][w], SHAPE, 5000, True, (0.0, 400.0))
    assert greys.limits == (0.0, 400.0)
    assert greys.scale[1] > 5000


def test_a_constant_volume():
    pair = [volumes()[0], np.ones(SHAPE, np.float32)]
    with pytest.raises(InputError, match="the volume after compression is constant"):
        Greys.of(lambda k, w: pair[k][w], SHAPE, 5000, True)


def test_a_margin_ends_with_the_volume():
    around, inner = grown((slice(2, 9), slice(30, 40)), 4, (30, 40))
    assert around == (slice(0, 13), slice(26, 40))
    assert inner == (slice(2, 9), slice(4, 14))
