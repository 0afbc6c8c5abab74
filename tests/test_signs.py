"""The one convention of axes and signs, checked end to end.

x1 = lateral = columns, to the right; x2 = axial = rows, down; component 0 is lateral;
I2(x + u(x)) = I1(x); compression moves the bottom up, so u2 < 0 there.
"""

import numpy as np
import pytest

import eofm
from eofm.imaging.splines import evaluate, gradient, warp
from eofm.settings import WARPING

RIGHT_DOWN = np.array([1.5, -0.75])


def blob(centre, shape=(40, 56), sigma=3.0):
    x2, x1 = np.mgrid[: shape[0], : shape[1]]
    return np.exp(-((x1 - centre[0]) ** 2 + (x2 - centre[1]) ** 2) / (2 * sigma**2))


def test_first_coordinate_is_lateral_second_axial():
    I = np.zeros((5, 9))
    I[1, 7] = 1
    assert evaluate(I, np.array([[7.0], [1.0]]))[0] == pytest.approx(1)


def test_gradient_of_a_ramp_along_each_axis():
    x2, x1 = np.mgrid[:12, :17].astype(float)
    inner = np.s_[:, 3:-3, 3:-3]
    np.testing.assert_allclose(gradient(x1)[inner][0], 1, atol=0.05)
    np.testing.assert_allclose(gradient(x1)[inner][1], 0, atol=1e-12)
    np.testing.assert_allclose(gradient(x2)[inner][1], 1, atol=0.05)


def test_warping_the_second_image_gives_the_first():
    centre = np.array([25.0, 18.0])
    u = np.broadcast_to(RIGHT_DOWN[:, None, None], (2, 40, 56))
    warped, _ = warp(blob(centre + RIGHT_DOWN), u)
    np.testing.assert_allclose(warped, blob(centre), atol=2e-3)


def test_estimate_points_from_the_first_image_to_the_second():
    centre = np.array([25.0, 18.0])
    settings = eofm.Estimation(method="paper", alpha=0.01, scales=3, warps=3, **WARPING)
    u = eofm.estimate_displacement(blob(centre), blob(centre + RIGHT_DOWN), settings).u
    np.testing.assert_allclose(u[:, 18, 25], RIGHT_DOWN, atol=0.1)


def test_track_points_from_the_first_image_to_the_second():
    centre = np.array([25.0, 18.0])
    table = eofm.track(blob(centre), blob(centre + RIGHT_DOWN))
    row = table.iloc[table.area.argmax()]
    np.testing.assert_allclose(row[["x1", "x2"]].astype(float), centre, atol=0.1)
    np.testing.assert_allclose(row[["u1", "u2"]].astype(float), RIGHT_DOWN, atol=0.02)


def test_phantom_moves_bubbles_by_the_field():
    u = np.zeros((2, 40, 56))
    u[0], u[1] = RIGHT_DOWN[:, None, None] * np.ones((40, 56))
    _, after, bubbles = eofm.make_phantom(u, eofm.Phantom(count=1, sigma=(3, 3), seed=4))
    moved = bubbles[["x1", "x2"]].to_numpy()[0] + RIGHT_DOWN
    assert tuple(moved.round().astype(int)[::-1]) == np.unravel_index(after.argmax(), after.shape)
    np.testing.assert_allclose(bubbles[["u1", "u2"]].to_numpy()[0], RIGHT_DOWN, atol=1e-6)


def test_compression_moves_the_bottom_up_and_the_sides_out(truth, sample):
    np.testing.assert_allclose(truth[1, -1], -sample.compression, atol=1e-9)
    np.testing.assert_allclose(truth[:, 0], 0, atol=1e-9)
    assert truth[0, 30, 0] < -0.5
    assert truth[0, 30, -1] > 0.5
