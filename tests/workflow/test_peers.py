"""The other tools, as far as they are installed, obey our sign and order of components."""

import runpy
from typing import get_args

import numpy as np
import pytest
from conftest import speckle

from eofm.app.config import Tool, VolumeTool
from eofm.imaging.splines import evaluate

pytestmark = pytest.mark.slow

SHAPE = (90, 121)
PEERS = get_args(Tool)[2:]


@pytest.fixture(scope="module")
def peers(pytestconfig):
    return runpy.run_path(pytestconfig.rootpath / "workflow/scripts/peers.py")


@pytest.fixture(scope="module")
def moved():
    """A speckle image sampled by a known field, and that field."""
    x2, x1 = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    s1, s2 = x1 / (SHAPE[1] - 1), x2 / (SHAPE[0] - 1)
    u = np.stack([1.5 * np.sin(np.pi * s2) * (s1 - 0.3), -2.5 * s2 + 0.3 * np.cos(3 * s1)])
    after = speckle(SHAPE, np.random.default_rng(3), blur=2.0)
    return evaluate(after, np.stack([x1, x2]) + u), after, u


def test_the_tools_are_those_of_the_configuration(peers):
    assert tuple(peers["TOOLS"]) == PEERS


@pytest.mark.parametrize("tool", PEERS)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_known_smooth_field_is_found(peers, moved, tool):
    I1, I2, u = moved
    found = peers["estimate"](tool, I1, I2)
    if found is None:
        assert tool not in ("tvl1", "ilk")
        pytest.skip(f"{tool} is not installed")
    assert found.shape == u.shape
    inner = np.s_[:, 10:-10, 10:-10]
    assert np.linalg.norm((found - u)[inner]) < 0.1 * np.linalg.norm(u[inner])


def test_a_missing_library_is_reported_and_no_error(peers, moved, monkeypatch, capsys):
    for library in ("cv2", "itk", "SimpleITK", "pyxel"):
        monkeypatch.setitem(__import__("sys").modules, library, None)
    for tool in ("dis", "deepflow", "elastix", "demons", "pyxel"):
        assert peers["estimate"](tool, *moved[:2]) is None
        assert f"{tool}: not installed" in capsys.readouterr().out


@pytest.fixture(scope="module")
def moved_volumes():
    """Two volumes of speckle of which one is sampled by a known field, and that field."""
    shape = (48, 56, 64)
    x3, x2, x1 = np.mgrid[*map(slice, shape)].astype(float)
    u = np.stack([0.8 * x2 / 55, -1.5 * x2 / 55, 0.6 * np.sin(x1 / 20)])
    after = speckle(shape, np.random.default_rng(3), blur=2.0).astype(np.float32)
    before = evaluate(after, np.stack([x1, x2, x3]) + u)
    return before, after, u


def test_the_tools_for_volumes_are_those_of_the_configuration(peers):
    assert set(peers["VOLUMES"]) == set(get_args(VolumeTool)[2:])


@pytest.mark.parametrize("tool", get_args(VolumeTool)[2:])
@pytest.mark.filterwarnings("ignore")
def test_a_known_motion_of_a_volume_is_found(peers, moved_volumes, tool):
    I1, I2, u = moved_volumes
    found = peers["estimate"](tool, I1, I2)
    if found is None:
        assert tool not in ("tvl1", "ilk")
        pytest.skip(f"{tool} is not installed")
    assert found.shape == u.shape
    inner = np.s_[:, 12:-12, 12:-12, 12:-12]
    known = np.isfinite(found[inner])
    assert known.any()
    # The elevational component as well, so that no axis is taken for another.
    for c in range(3):
        error = (found - u)[inner][c][known[c]]
        assert np.sqrt(np.mean(error**2)) < 0.2
