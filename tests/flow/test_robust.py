"""What changes between two images beside the motion, and motions that are large."""

import numpy as np
import pytest
from conftest import speckle as texture

import eofm
import eofm.flow.estimate
import eofm.grid
from eofm.flow.likeness import unlike
from eofm.flow.matching import Overall
from eofm.flow.pair import brightness
from eofm.flow.start import consistent, match_blocks
from eofm.grid import Grid
from eofm.imaging.defects import Levels, defects, defects_by_kind
from eofm.imaging.intensity import Window, normalise_locally

SHAPE = (96, 112)


def motion(shape=SHAPE, size=2.0):
    x2, x1 = np.mgrid[: shape[0], : shape[1]] / np.reshape(shape, (2, 1, 1))
    return size * np.stack([0.6 * (x1 - 0.5) * np.sin(np.pi * x2), -x2 + 0.1 * np.sin(4 * x1)])


def speckle(u, seed=3):
    count = int(0.08 * u[0].size)
    phantom = eofm.Phantom(count=count, sigma=(1.2, 1.8), brightness=(0.3, 1.0), seed=seed)
    I1, I2, _ = eofm.make_phantom(u, phantom)
    return I1 / I1.max(), I2 / I1.max()


def error(I1, I2, u, **settings):
    found = eofm.estimate_displacement(I1, I2, eofm.Estimation(**settings)).u
    return float(np.hypot(*(found - u)).mean())


def ramp(I):
    return I * np.linspace(1.1, 0.4, len(I))[:, None]


def shadow(I):
    x2, x1 = np.mgrid[: len(I), : len(I[0])] / np.reshape(I.shape, (2, 1, 1))
    return I * (1 - 0.6 * (x2 > 0.3) * np.exp(-(((x1 - 0.5) / 0.15) ** 2)))


def highlights(I):
    I = I.copy()
    I[10:90:17, 9:100:21] = 5.0
    return I


def line(I):
    I = I.copy()
    I[40:42] = 1.0
    return I


def impulsive(seed):
    """Salt and pepper on one pixel in fifty."""

    def change(I):
        rng = np.random.default_rng(seed)
        return np.where(rng.random(I.shape) < 0.02, rng.choice([0.0, 1.2], I.shape), I)

    return change


CHANGES = {
    "ramp": (lambda I: I, ramp, 0.04),
    "shadow": (lambda I: I, shadow, 0.04),
    "gain": (lambda I: I, lambda I: 0.7 * I, 0.02),
    "gain and offset": (lambda I: I, lambda I: 0.7 * I + 0.15, 0.02),
    "gamma": (lambda I: I, np.sqrt, 0.05),
    "highlights appear": (lambda I: I, highlights, 0.02),
    "highlights stay": (highlights, highlights, 0.02),
    "saturated line": (line, line, 0.03),
    "impulses": (impulsive(3), impulsive(4), 0.03),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_no_motion_is_not_taken_for_one(name):
    before, after, bound = CHANGES[name]
    u = motion()
    I1, I2 = speckle(u)
    I1, I2 = before(I1), after(I2)
    assert error(I1, I2, u) < bound < error(I1, I2, u, robust=False)


def test_nothing_is_lost_without_a_change():
    u = motion()
    images = speckle(u)
    assert error(*images, u) < 1.05 * error(*images, u, robust=False)


@pytest.mark.parametrize("change", [lambda I: I, lambda I: 0.7 * I + 0.1, highlights])
def test_no_motion_gives_zero(change):
    I = speckle(0 * motion())[0]
    assert np.abs(eofm.estimate_displacement(I, change(I)).u).max() < 0.02


def test_same_bytes_each_time():
    I1, I2 = speckle(motion())
    first, second = (eofm.estimate_displacement(I1, ramp(I2)) for _ in range(2))
    assert np.array_equal(first.u, second.u)
    assert np.array_equal(first.deviation(4), second.deviation(4))


@pytest.mark.parametrize("shift", [(30.0, -25.0), (-28.0, 31.0)])
def test_a_shift_by_a_quarter_of_the_image_is_found(shift):
    shape = (128, 136)
    u = np.broadcast_to(np.reshape(shift, (2, 1, 1)), (2, *shape)).copy()
    found = eofm.estimate_displacement(*speckle(u)).u
    seen = eofm.grid.inside(shape, u + np.mgrid[: shape[0], : shape[1]][::-1])
    assert np.hypot(*(found - u))[seen].mean() < 0.05


@pytest.mark.parametrize(("shape", "shift"), [((24, 160), (24.0, -2.0)), ((160, 40), (3.0, 25.0))])
def test_a_far_shift_of_a_strip_is_found(shape, shift):
    u = np.broadcast_to(np.reshape(shift, (2, 1, 1)), (2, *shape)).copy()
    found = eofm.estimate_displacement(*speckle(u)).u
    seen = eofm.grid.inside(shape, u + np.mgrid[: shape[0], : shape[1]][::-1])
    assert np.hypot(*(found - u))[seen].mean() < 0.05


def test_blocks_are_found_where_they_moved():
    u = motion((96, 96), 6.0)
    images = (normalise_locally(I, (8.0, 8.0)) for I in speckle(u))
    found = match_blocks(*(I - I.mean() for I in images), Grid((96, 96), (2.0, 0.5)))
    assert found is not None
    inner = np.s_[:, 12:-12, 12:-12]
    assert np.abs(found / np.reshape([2.0, 0.5], (2, 1, 1)) - u)[inner].max() < 1.0


def waves(x, octaves=3):
    """An image of large structures, from 5 px on, at any points."""
    rng = np.random.default_rng(5)
    length = 5 * 2 ** rng.uniform(0, octaves, 60)
    turn, phase = rng.uniform(0, 2 * np.pi, (2, 60))
    k = 2 * np.pi / length * np.stack([np.cos(turn), np.sin(turn)])
    parts = np.cos(np.tensordot(k, x, (0, 0)) + phase[:, None, None])
    return np.tensordot(length / length.sum(), parts, 1)


def test_what_appears_pulls_nothing():
    u = motion((128, 128), 4.0)
    x = np.mgrid[:128, :128][::-1].astype(float)
    I1, I2 = waves(x + u), waves(x)
    patch = np.s_[40:70, 30:70]
    I2[patch] = I2.min()
    found = eofm.estimate_displacement(I1, I2)
    live = found.pair.live
    assert not live[48:68, 38:66].any()
    assert live.mean() > 0.7
    assert np.hypot(*(found.u - u)).mean() < 0.15
    assert error(I1, I2, u, robust=False) > 0.5


@pytest.mark.parametrize("dark", [True, False])
def test_what_appears_is_left_out_and_little_beside_it(rng, dark):
    """A coarse scale sees it larger by some of its samples; fine ones take that back."""
    u = motion((176, 176), 3.0)
    I1, I2 = speckle(u)
    x2, x1 = np.mgrid[:176, :176]
    distance = np.hypot(x1 - 100, x2 - 80) - 14
    I2 = np.where(distance > 0, I2, 0.0 if dark else 0.9)
    I1, I2 = (I + 0.05 * I1.std() * rng.normal(size=I.shape) for I in (I1, I2))
    found = eofm.estimate_displacement(I1, I2)
    # Where the disc hides what I1 shows.
    y = np.stack([x1, x2]) + u
    distance = np.hypot(y[0] - 100, y[1] - 80) - 14
    assert found.pair.live[distance < -3].mean() < 0.05
    assert found.pair.live[distance > 6].mean() > 0.97
    beside = (distance > 0) & (distance < 10)
    assert np.hypot(*(found.u - u))[beside].mean() < 0.05


def test_what_is_left_of_the_motion_of_large_structures_is_no_brightness(monkeypatch):
    u = motion((128, 128), 4.0)
    x = np.mgrid[:128, :128][::-1].astype(float)
    x2, x1 = np.mgrid[:128, :128] - 64.0
    u[1] -= 3 * np.exp(-(x1**2 + x2**2) / (2 * 20**2))
    I1, I2 = waves(x + u), waves(x)
    found = eofm.estimate_displacement(I1, I2)
    assert found.pair.even
    shaded = eofm.estimate_displacement(I1, I2 * np.linspace(1.05, 0.95, 128)[:, None])
    assert not shaded.pair.even
    off = np.hypot(*(found.u - u)).mean()
    monkeypatch.setattr(eofm.flow.estimate, "STEADY", 0.0)
    assert off < 0.7 * error(I1, I2, u)


@pytest.mark.parametrize("change", ["ramp", "gamma"])
def test_brightness_that_changes_within_structures_is_no_motion(change, caplog, monkeypatch):
    u = motion((128, 128), 4.0)
    x = np.mgrid[:128, :128][::-1].astype(float)
    I1, I2 = (I - waves(x, 5).min() + 0.02 for I in (waves(x + u, 5), waves(x, 5)))
    I2 = ramp(I2) if change == "ramp" else I2**0.5
    with caplog.at_level("DEBUG", "eofm"):
        found = error(I1, I2, u)
    assert "normalised locally" in caplog.text
    monkeypatch.setattr(eofm.flow.estimate, "SHADED", np.inf)
    assert found < 0.5 * error(I1, I2, u)


def test_ramps_are_no_contrast():
    """Local means and contrasts follow a ramp up to the edges."""
    I = speckle(motion())[0]
    used = np.ones(SHAPE, dtype=bool)
    ramp = np.linspace(0, 2, SHAPE[0])[:, None] + np.zeros(SHAPE)
    gain, offset, _ = brightness(I, 0.7 * I + ramp, used, Overall())
    assert np.abs(gain / 0.7 - 1).max() < 0.02
    assert np.abs(offset - ramp).max() < 0.02


def test_what_images_do_not_share(rng):
    """Is told where it is the exception, and not where most of them differs."""
    I1 = speckle(motion())[0]
    grid, still, live = Grid(SHAPE), np.zeros((2, *SHAPE)), np.ones(SHAPE, dtype=bool)
    I2 = 0.5 * I1 + 0.1
    assert unlike(I1, I2, still, grid, live) is None
    I2[40:64, 50:80] = rng.permutation(I2[40:64, 50:80].ravel()).reshape(24, 30)
    found = unlike(I1, I2, still, grid, live)
    assert found[44:60, 54:76].all()
    found[30:74, 40:90] = False
    assert not found.any()
    live[24:80, 34:96] = False
    assert unlike(I1, I2, still, grid, live) is None
    live[:] = True
    I2[:, :80] = rng.random((SHAPE[0], 80))
    assert unlike(I1, I2, still, grid, live) is None


def test_blocks_of_unrelated_images_say_nothing():
    one, other = (speckle(motion((96, 96)), seed)[0] for seed in (1, 2))
    assert match_blocks(one - one.mean(), other - other.mean(), Grid((96, 96))) is None


def test_a_motion_against_its_neighbours_is_not_consistent():
    u = np.zeros((2, 5, 5))
    u[0, 2, 2] = 9.0
    good = consistent(u, np.ones((5, 5), dtype=bool))
    assert not good[2, 2]
    assert good.sum() == 24


def test_defects_are_highlights_and_saturated_lines_and_nothing_else():
    I = speckle(motion())[0]
    assert not defects(I).any()
    assert not defects(np.minimum(I, 0.5)).any()
    found = defects(highlights(I))
    assert found[10:90:17, 9:100:21].all()
    assert found.mean() < 0.1
    assert defects(line(I))[40:42].all()


def test_defects_have_kinds():
    I = line(speckle(motion())[0])
    I[10:12, 30:32] = 6.0
    I[70, 50] = 2.0
    found = defects_by_kind(I)
    at = {"highlights": [10, 30], "saturated lines": [40, 5], "single pixels": [70, 50]}
    assert set(found) == set(at)
    for kind, mask in found.items():
        assert [mask[*place] for place in at.values()] == [kind == other for other in at]
    assert np.array_equal(defects(I), sum(found.values()) > 0)


def test_defects_of_images_of_large_structures(rng):
    """These have few maxima: most of their pixels are those of highlights, which are flat."""
    x2, x1 = np.mgrid[:160, :160]
    I = sum(
        np.cos((x1 * np.cos(a) + x2 * np.sin(a)) / length + a)
        for a, length in zip(rng.uniform(0, 6, 24), rng.uniform(3, 20, 24), strict=True)
    )
    I = 0.5 + I / 20
    assert not defects(I).any()
    spots = np.zeros(I.shape, dtype=bool)
    for i, j in rng.integers(5, 150, (12, 2)):
        spots[i : i + 3, j : j + 3] = True
    found = defects(np.where(spots, 4.0, I))
    assert found[spots].all()
    assert found.mean() < 0.05
    # Not the brightest, for structures or highlights may be brighter; dark ones are as the ground.
    J = np.where(spots, 4.0, I)
    J[60:62] = np.quantile(I, 0.9)
    found = marked(J)
    assert found[60:62].all()
    assert not (found & ~spots)[63:].any()


def test_pieces_of_one_value_that_are_not_straight_are_no_lines():
    """Structures that are clipped, or painted, are as flat beside each of their rows."""
    x2, x1 = np.mgrid[:120, :160]
    I = speckle(motion((120, 160)))[0]
    I[np.hypot(x1 - 80, x2 - 60) < 40] = 0.8
    assert not marked(I).any()
    assert marked(line(I))[40:42].all()


def impulses(I):
    return Levels.of(I).single(I)


def marked(I):
    return Levels.of(I).marked(I)


def test_impulses_are_single_pixels(rng):
    I = speckle(motion())[0]
    at = tuple(rng.integers(0, n, 20) for n in I.shape)
    J = I.copy()
    J[at] = np.where(I[at] > 0.5, 0.0, 1.0)
    found = impulses(J)
    assert found[at].mean() > 0.8
    found[at] = False
    assert not found.any()
    volume = np.stack([I] * 7)
    assert not impulses(volume).any()
    volume[3, 20, 30] = 2.0
    assert np.argwhere(impulses(volume)).tolist() == [[3, 20, 30]]


@pytest.mark.parametrize("sigma", [0.7, 1.0])
def test_points_as_a_lens_shows_them_are_no_impulses(sigma):
    look = eofm.Phantom(count=300, sigma=(sigma, sigma), noise=0.01, seed=7)
    assert impulses(eofm.make_phantom(motion(), look)[0]).mean() < 1e-3


def test_the_skin_is_no_defect(rng):
    """Below air, which is all noise, a bright surface is far above most maxima, and clipped."""
    depth = np.arange(256)[:, None] - 180 - 3 * np.sin(np.arange(200) / 9)
    I = 0.05 * rng.random(depth.shape) + 0.3 * rng.random(depth.shape) * (depth > 0)
    I += rng.exponential(2.0, I.shape) * ((depth > 0) & (depth < 2))
    I += 2.0 * ((depth >= 2) & (depth < 5))
    clipped = np.minimum(I, 1.0)
    assert np.count_nonzero(clipped == 1) > 600
    assert not marked(I).any()
    assert not marked(clipped).any()
    found = marked(line(clipped))
    assert found[40:42].all()
    assert not found[44:].any()


def test_window_is_a_gaussian_average_over_a_mask(rng):
    f, mask = rng.normal(size=(60, 70)), rng.random((60, 70)) < 0.8
    x2, x1 = np.mgrid[:60, :70]
    w = mask * np.exp(-((x2 - 5) ** 2 + (x1 - 40) ** 2) / (2 * 8.0**2))
    assert Window(mask, 8.0).mean(f)[5, 40] == pytest.approx((w * f).sum() / w.sum(), abs=0.02)
    assert np.allclose(Window(mask, 8.0).mean(np.ones((60, 70))), 1)


@pytest.mark.parametrize("noise", [0.05, 0.1])
def test_two_thirds_of_errors_lie_within_a_deviation(noise):
    u = motion()
    rng = np.random.default_rng(6)
    I1, I2 = (I + noise * rng.normal(size=I.shape) for I in speckle(u))
    found = eofm.estimate_displacement(I1, I2)
    off, bars = np.abs(found.u - u), found.deviation(16)
    assert 0.55 < np.mean(off < bars) < 0.8
    assert 0.88 < np.mean(off < 1.96 * bars) < 0.99


def test_draws_do_not_grow_where_data_determine_the_field():
    found = eofm.estimate_displacement(*speckle(motion()), eofm.Estimation(alpha=1e-4))
    sizes = [np.sqrt(np.mean(error**2)) for error in found.samples(12)]
    assert max(sizes[6:]) < 3 * max(sizes[:6])


def test_motion_of_a_short_wavelength_is_found():
    shape = (160, 160)
    x2, x1 = np.mgrid[:160, :160] * (2 * np.pi / 45)
    u = motion(shape) + 1.2 * np.stack([np.sin(x1) * np.cos(x2), np.cos(x1) * np.sin(x2)])
    x = np.mgrid[:160, :160][::-1].astype(float)
    assert error(waves(x + u), waves(x), u) < 0.2


@pytest.mark.parametrize("moves", [(0, 0), (-5, 9)])
def test_an_object_that_moves_otherwise_is_told_and_one_that_appears_is_left_out(moves):
    """Before a background at rest, whose field stays right."""
    rng = np.random.default_rng(3)
    ground, body, other = (texture((160, 200), rng, 2.0) for _ in range(3))
    first, then = (np.s_[60 : 60 + 48, 80 : 80 + 56] for _ in range(2))
    then = tuple(slice(s.start + d, s.stop + d) for s, d in zip(first, moves, strict=True))
    I1, I2 = ground.copy(), ground.copy()
    moving = moves != (0, 0)
    I1[first] = body[first]
    I2[then] = body[first] if moving else other[first]
    I1, I2 = (I + rng.normal(0, 0.02, I.shape) for I in (I1, I2))
    found = eofm.estimate_displacement(I1, I2)
    away = np.ones(I1.shape, dtype=bool)
    away[40:130, 60:160] = False
    assert np.abs(found.u[:, away]).max() < 0.05
    if moving:
        assert found.astray > 0.01
        assert found.trust.verdict == "doubtful"
        assert [reason for reason in found.trust.reasons if "moved elsewhere" in reason]
    else:
        assert found.astray == 0
        assert 0.5 * 48 * 56 < found.unlike * I1.size < 2 * 48 * 56


@pytest.mark.parametrize("sides", [(1, 1), (3, 1), (1, 3)])
def test_what_is_told_of_an_object_does_not_depend_on_the_shape_of_pixels(sides):
    from eofm.flow.elsewhere import AWAY, Elsewhere

    moved, where = np.zeros((2, 8, 10)), np.zeros((8, 10), dtype=bool)
    moved[0], where[:4] = 12.0, True
    seen = Elsewhere(where, moved)
    assert seen.astray(np.zeros_like(moved)) == 0.5
    near = moved.copy()
    near[1] = 0.9 * AWAY
    assert seen.astray(near) == 0
    rng = np.random.default_rng(3)
    ground, body = (texture((160, 200), rng, 2.0) for _ in range(2))
    I1, I2 = ground.copy(), ground.copy()
    I1[60:108, 80:136], I2[55:103, 89:145] = body[60:108, 80:136], body[60:108, 80:136]
    found = eofm.estimate_displacement(I1, I2, known=eofm.Known(pixel_size=sides))
    assert 0.01 < found.astray < 2 * 48 * 56 / I1.size
