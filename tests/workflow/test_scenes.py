"""Images of the target ``robustness`` show the motion that they are said to."""

import sys
from pathlib import Path

import numpy as np
import pytest

from eofm.imaging.splines import evaluate

sys.path.insert(0, str(Path(__file__).parents[2] / "workflow/scripts"))
import scenes
from conditions import CONDITIONS, under
from textures import TEXTURES

SHAPE = (64, 80)


@pytest.mark.parametrize("name", scenes.RENDERERS)
def test_the_image_after_at_moved_points_is_that_before(name):
    u = scenes.smooth_motion(SHAPE, 3.0, 1) + scenes.shear_band(SHAPE)
    scene = scenes.RENDERERS[name](u, 1)
    inner = np.s_[10:-10, 10:-10]
    x = u + np.mgrid[: SHAPE[0], : SHAPE[1]][::-1]
    carried = (evaluate(scene.I2, x) - scene.I1)[inner]
    still = (scene.I2 - scene.I1)[inner]
    assert np.abs(carried).mean() < 0.5 * np.abs(still).mean()


@pytest.mark.parametrize("name", TEXTURES)
def test_a_texture_is_a_function_of_points(name):
    at = TEXTURES[name](np.random.default_rng(2))
    x = np.random.default_rng(3).uniform(0, 200, (2, 5, 6))
    again = TEXTURES[name](np.random.default_rng(2))(x[:, 2:3, 3:4])
    assert at(x)[2, 3] == again
    assert np.ptp(at(x)) > 0.1
    other = TEXTURES[name](np.random.default_rng(4))(x)
    assert not np.allclose(at(x), other)


def test_motions_are_as_large_as_they_say():
    band = scenes.shear_band((101, 101))
    assert np.hypot(*(band[:, 90, 50] - band[:, 10, 50])) == pytest.approx(3, abs=0.01)
    assert np.hypot(*(band[:, 55, 50] - band[:, 45, 50])) > 0.8 * 3
    assert np.abs(scenes.fast((90, 90))).max() == pytest.approx(1.2, abs=0.02)


@pytest.mark.parametrize("name", CONDITIONS)
def test_a_condition_changes_images_and_nothing_else(name):
    clean = scenes.dense(scenes.smooth_motion(SHAPE, 2.0, 1), 1)
    changed = under(clean, name, 1)
    assert np.array_equal(changed.I2, clean.I2) == (name in ("none",))
    assert changed.u is clean.u
    again = under(clean, name, 1)
    assert np.array_equal(changed.I1, again.I1)
    assert np.array_equal(changed.I2, again.I2)
