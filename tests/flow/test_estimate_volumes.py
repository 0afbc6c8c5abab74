"""The estimate of volumes: the same method as that of images, one axis more."""

import numpy as np
import pandas as pd
import pytest

import eofm
from eofm.compiled import use_threads
from eofm.errors import InputError
from eofm.flow.matching import Match
from eofm.grid import Grid
from eofm.settings import Estimation

SHAPE = (20, 34, 41)
# Its choice takes most of the time, and is not what most of these are about.
STATED = Estimation(alpha=1.0)


def lengths(d):
    return np.sqrt((d**2).sum(0))


def moved(shape=SHAPE):
    x3, x2, x1 = np.mgrid[: shape[0], : shape[1], : shape[2]]
    u1, u2 = 0.02 * x1 + 0.01 * x2, -0.05 * x2 + 0.01 * x1
    return np.stack([u1, u2, 0.6 * np.sin(x2 / 12) + 0.02 * x3]).astype(np.float32)


@pytest.fixture(scope="module")
def pair():
    u = moved()
    look = eofm.Phantom(count=600, sigma=(1.3, 1.3), seed=2)
    return u, *eofm.make_phantom(u, look)


@pytest.fixture(scope="module")
def found(pair):
    _, I1, I2, _ = pair
    return eofm.estimate_displacement(I1, I2)


def test_all_components_are_found(pair, found):
    u, *_ = pair
    assert found.u.shape == u.shape
    assert found.u.dtype == np.float32
    assert lengths(found.u - u).mean() < 0.05
    assert found.trust.verdict == "good"
    assert found.trust.map.shape == SHAPE


def test_error_bars_have_the_size_of_the_errors(pair, found):
    u, *_ = pair
    bars = found.deviation(8)
    assert bars.shape == u.shape
    within = np.mean(np.abs(found.u - u) < bars)
    assert 0.3 < within < 0.95


@pytest.mark.parametrize("sides", [(3.0, 3.0, 60.0), (60.0, 3.0, 60.0), (3.0, 60.0, 3.0)])
def test_flat_voxels_are_no_reason_to_fail(sides):
    """Smoothness in true lengths alone would be 10^5 times stiffer across them than along."""
    x3, x2, x1 = np.mgrid[:20, :30, :34]
    u = np.stack([0.01 * x1, -0.03 * x2, 0.01 * x3 + 0.3]).astype(np.float32)
    I1, I2, _ = eofm.make_phantom(u, eofm.Phantom(count=500, sigma=(1.3, 1.3), seed=2))
    found = eofm.estimate_displacement(I1, I2, known=eofm.Known(pixel_size=sides))
    assert lengths(found.u - u).mean() < 0.05
    # No side counts as more than four times the shortest.
    assert max(found.spacing) == pytest.approx(4 * min(found.spacing))


def test_no_motion_gives_none(pair):
    _, I1, *_ = pair
    same = eofm.estimate_displacement(I1, I1)
    assert np.abs(same.u).max() < 1e-5
    assert "the same" in same.trust.reasons[0]


def test_stacked_images_move_like_one_of_them():
    """A volume that does not change along its slices has the functional of an image.

    It says nothing of the motion across them, which two faces do.
    """
    settings = Estimation(alpha=3.0, scales=2, robust=False, denoising=0.0)
    u = moved()[:2, 0].astype(float)
    I1, I2, _ = eofm.make_phantom(u, eofm.Phantom(count=150, seed=3))
    image = eofm.estimate_displacement(I1, I2, settings).u
    stacks = (np.repeat(I[None], 14, axis=0) for I in (I1, I2))
    face = np.concatenate([image, 0 * image[:1]])
    known = eofm.Known(edges={"front": face, "back": face})
    volume = eofm.estimate_displacement(*stacks, settings, known).u
    assert np.abs(volume[2]).max() < 5e-3
    assert np.abs(volume[:2] - image[:, None]).max() < 1e-2


@pytest.mark.parametrize("component", range(3))
def test_each_component_points_along_its_axis(component):
    u = np.zeros((3, 16, 20, 24), np.float32)
    u[component] = 0.7
    I1, I2, _ = eofm.make_phantom(u, eofm.Phantom(count=120, sigma=(1.5, 1.5), seed=5))
    found = eofm.estimate_displacement(I1, I2).u
    inner = found[:, 4:-4, 4:-4, 4:-4].mean(axis=(1, 2, 3))
    np.testing.assert_allclose(inner, u[:, 0, 0, 0], atol=0.05)


def test_what_is_known_helps(pair):
    u, I1, I2, bubbles = pair

    def error(settings=STATED, **known):
        e = eofm.estimate_displacement(I1, I2, settings, eofm.Known(**known))
        return lengths(e.u - u).mean()

    alone = error()
    faces = {"top": u[:, :, 0], "bottom": u[:, :, -1], "front": u[:, 0], "back": u[:, -1]}
    assert error(edges=faces) < alone
    assert error(STATED.changed(edge_weight=1.0), edges=faces) < alone
    assert error(background=u, bubbles=bubbles) < alone


def test_faces_of_known_motion_move_so(pair):
    u, I1, I2, _ = pair
    faces = {"left": u[..., 0], "back": np.zeros((3, 1, 1))}
    found = eofm.estimate_displacement(I1, I2, STATED, eofm.Known(edges=faces)).u
    # What both faces share belongs to the one that comes later.
    np.testing.assert_allclose(found[:, :, :, 0], u[:, :, :, 0], atol=1e-6)
    assert not found[:, -1, :, 1:].any()


def test_the_papers_method(pair):
    u, I1, I2, bubbles = pair
    settings = Estimation(method="paper", zero_edges=("top", "bottom"), limits=(0, 1))
    alone = 0.9 * u
    known = eofm.Known(bubbles=bubbles, background=alone)
    found = eofm.estimate_displacement(I1, I2, settings, known).u
    assert lengths(found - u).mean() < 0.8 * lengths(alone - u).mean()
    np.testing.assert_allclose(found[:, :, 0], alone[:, :, 0], atol=1e-5)


def test_dead_zones_carry_no_data(pair):
    u, I1, I2, _ = pair
    dead = np.zeros(SHAPE, dtype=bool)
    dead[6:12, 10:18, 12:20] = True
    spoilt = np.where(dead, 0.9, I1).astype(np.float32), np.where(dead, 0.0, I2).astype(np.float32)
    found = eofm.estimate_displacement(*spoilt, known=eofm.Known(dead=dead))
    assert lengths(found.u - u)[~dead].mean() < 0.06
    assert np.isnan(found.trust.map[dead]).all()


def test_only_ratios_of_voxel_sides_matter(pair):
    _, I1, I2, _ = pair
    one, two = (
        eofm.estimate_displacement(I1, I2, STATED, eofm.Known(pixel_size=size)).u
        for size in ((3.0, 6.0, 4.0), (1.5, 3.0, 2.0))
    )
    np.testing.assert_array_equal(one, two)


def test_threads_do_not_matter(pair, found):
    _, I1, I2, _ = pair
    use_threads(1)
    alone = eofm.estimate_displacement(I1, I2).u
    np.testing.assert_array_equal(alone, found.u)


@pytest.mark.parametrize("depth", [5, 12])
def test_a_few_slices_that_move_far(depth):
    """Blocks are matched in one layer, which tells no slope across it."""
    shape = (depth, 80, 84)
    u = np.zeros((3, *shape), dtype=np.float32)
    u[:] = np.reshape([8.0, -5.0, 0.2], (3, 1, 1, 1))
    look = eofm.Phantom(count=depth * 120, sigma=(1.3, 1.3), distance=3, seed=3)
    I1, I2, _ = eofm.make_phantom(u, look)
    found = eofm.estimate_displacement(I1, I2, STATED)
    assert lengths(found.u - u)[:, 10:-10, 10:-10].mean() < 0.05
    assert found.trust.verdict == "good"


def test_thin_volumes(pair):
    _, I1, I2, _ = pair
    assert eofm.estimate_displacement(I1[:4], I2[:4]).u.shape == (3, 4, *SHAPE[1:])
    with pytest.raises(InputError, match="too thin"):
        eofm.estimate_displacement(I1[:3], I2[:3])


def test_what_does_not_fit_is_refused(pair):
    u, I1, I2, _ = pair
    table = pd.DataFrame({"x1": [3.0], "x2": [3.0], "u1": [0.0], "u2": [0.0]})
    for images, known, message in (
        ((I1, I2[0]), eofm.Known(), "differ in size"),
        ((I1, I2), eofm.Known(pixel_size=(3.0, 6.0)), "elevational size"),
        ((I1, I2), eofm.Known(bubbles=table), "column x3 is missing"),
        ((I1[0], I2[0]), eofm.Known(edges={"front": u[:2, 0]}), "front: is a face of volumes"),
        ((I1[None], I2[None]), eofm.Known(), "arrays of shape"),
        ((I1[..., :3], I2[..., :3]), eofm.Known(), "looks like a colour image"),
        ((1e18 * I1, I2), eofm.Known(), "lost in rounding"),
        ((I1, I2), eofm.Known(edges={"front": u[:, 0, :5]}), r"front: wanted .*\(3, 34, 41\)"),
        ((I1, I2), eofm.Known(edges={"up": np.zeros((3, 1, 1))}), "up: is no edge"),
        ((I1, I2), eofm.Known(background=u[:2]), "background: wanted"),
    ):
        with pytest.raises(InputError, match=message):
            eofm.estimate_displacement(*images, known=known)
    with pytest.raises(InputError, match="front is an edge of volumes"):
        eofm.estimate_displacement(I1[0], I2[0], Estimation(zero_edges=("front",)))


@pytest.mark.parametrize("shape", [(12, 14, 17), (30, 34)])
def test_white_noise_does_not_stretch_volumes_at_their_faces(rng, shape):
    """Derivatives across faces have the noise of the voxel itself; those along them do not."""
    ndim = len(shape)
    g, r = rng.normal(size=(ndim, *shape)), rng.normal(size=shape)
    match = Match(Grid(shape), np.zeros_like(g), g.copy(), r, np.ones(shape, dtype=bool))
    seen = match.shared(g.copy(), 0.0).g
    across = np.zeros((ndim, *shape), dtype=bool)
    for c in range(ndim):
        np.moveaxis(across[c], ndim - 1 - c, 0)[[0, 1, -2, -1]] = ndim == 3
    assert np.all(seen[across] == 0)
    assert np.all(seen[~across] != 0)
