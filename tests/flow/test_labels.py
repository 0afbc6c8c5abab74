"""What is printed on both images and does not move with the sample."""

import numpy as np
import pytest
from test_robust import SHAPE, error, motion, speckle

import eofm
from eofm.imaging.printed import frames, suspects

U = motion(size=4.0) + 1.0
X2, X1 = np.mgrid[: SHAPE[0], : SHAPE[1]]


def framed(I):
    I = I.copy()
    I[:9], I[-6:], I[:, :7], I[:, -12:] = 0.0, 0.0, 0.1, 0.1
    return I


def noisy(I, seed):
    return I + 0.02 * np.random.default_rng(seed).normal(size=I.shape)


def sector(I):
    depth, angle = np.hypot(X1 - 56, X2 + 40), np.arctan2(X1 - 56, X2 + 40)
    return np.where((depth > 48) & (depth < 128) & (abs(angle) < 0.5), I, 0.0)


def labelled(I):
    """Letters, and a bar."""
    I = I.copy()
    I[6:13, 8:40:4] = 1.0
    I[6:13:3, 8:40] = 1.0
    I[84:87, 60:100] = 1.0
    return I


def eight_bits(I):
    return np.round(255 * np.clip(I, 0, 1))


CHANGES = {
    "frame": lambda I, k: framed(I),
    "frame in noise": lambda I, k: noisy(framed(I), k),
    "frame of 8 bits": lambda I, k: eight_bits(framed(I)),
    "sector": lambda I, k: sector(I),
    "labels": lambda I, k: labelled(I),
}


def inside():
    """Where the sample is seen in both images, away from what is printed."""
    return slice(14, -10), slice(20, -22)


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_printed_pulls_nothing(name):
    I1, I2 = speckle(U)
    J1, J2 = (CHANGES[name](I, k) for k, I in enumerate((I1, I2)))
    found = eofm.estimate_displacement(J1, J2)
    plain = eofm.estimate_displacement(J1, J2, eofm.Estimation(robust=False))
    middle = (slice(30, 70), slice(40, 72)) if name == "sector" else inside()
    off, much = (np.hypot(*(f.u - U))[middle].mean() for f in (found, plain))
    assert off < 0.05
    assert off < 0.5 * much
    assert found.trust.verdict == "good"
    assert name == "labels" or 0.2 < found.printed.mean() < 0.8


@pytest.mark.parametrize("size", [4.0, 0.3, 0.0])
@pytest.mark.parametrize("levels", [None, 255, 40])
def test_nothing_is_printed_on_a_sample_that_moves_or_stays(levels, size):
    """Bubbles on black of few levels are of one value where there are none."""
    u = motion(size=size)
    for count in (60, 900):
        I1, I2, _ = eofm.make_phantom(u, eofm.Phantom(count=count, seed=2))
        if levels:
            I1, I2 = (np.round(I / I1.max() * levels) / levels for I in (I1, I2))
        found = eofm.estimate_displacement(I1, I2 if size else I1.copy())
        assert found.printed.mean() < 0.02


def test_black_between_dots_that_move_in_one_place_is_no_frame(rng):
    """It is of one value in both images, reaches the edges, and ends where dots begin."""

    def axial(x2):
        return -2.5 * np.exp(-((X1 - 50) ** 2 + (x2 - 45) ** 2) / (2 * 9.0**2))

    u = np.stack([np.zeros(SHAPE), axial(X2)])
    centres = rng.uniform(-4, [116, 100], (400, 2))
    bright, radius = rng.uniform(0.2, 1, 400), rng.uniform(1.5, 4, 400)

    def dots(x1, x2):
        distance = np.hypot(x1[..., None] - centres[:, 0], x2[..., None] - centres[:, 1])
        return (bright * np.clip(radius - distance + 0.5, 0, 1)).max(-1)

    x2 = X2.astype(float)
    for _ in range(60):
        x2 = X2 - axial(x2)
    I1, I2 = dots(X1, X2), dots(X1, x2)
    assert 0.3 < ((I1 == 0) & (I2 == 0)).mean() < 0.8
    found = eofm.estimate_displacement(I1, I2)
    assert found.printed.mean() < 0.02
    assert np.hypot(*(found.u - u)).mean() < 0.03


def test_frames_have_the_size_that_they_have():
    I1, I2 = map(framed, speckle(U))
    grown = np.ones(SHAPE, dtype=bool)
    grown[9 + 2 : -6 - 2, 7 + 2 : -12 - 2] = False
    np.testing.assert_array_equal(frames(I1, I2), grown)


@pytest.mark.parametrize("bits", [None, 255, 40])
def test_what_a_mask_leaves_out_is_not_printed_nor_what_is_next_to_it(bits):
    """A masked dark area, filled with one value as in `eofm sample`, is no frame."""
    u = motion(size=3.0)
    I1, I2, _ = eofm.make_phantom(u, eofm.Phantom(count=900, seed=2, base=0.05))
    dead = X2 - 10 * np.cos((X1 - 56) / 30) < 20
    for value in (0.0, np.median(I1[~dead])):
        J1, J2 = (np.where(dead, value, I) / I1.max() for I in (I1, I2))
        if bits:
            J1, J2 = (np.round(bits * J) for J in (J1, J2))
        assert frames(J1, J2).any()
        assert not frames(J1, J2, dead).any()
        if not bits:
            found = eofm.estimate_displacement(J1, J2, known=eofm.Known(dead=dead))
            assert not found.printed.any()


def test_what_a_mask_leaves_of_a_frame_is_printed():
    I1, I2 = map(framed, speckle(U))
    dead = X2 < 6
    expected = frames(I1, I2) & ~dead
    np.testing.assert_array_equal(frames(I1, I2, dead), expected)


def test_frames_of_volumes(rng):
    V1, V2 = rng.uniform(0.2, 1, (2, 14, 20, 24))
    for V in (V1, V2):
        V[:3], V[:, :, -4:] = 0.0, 0.0
    grown = np.ones(V1.shape, dtype=bool)
    grown[3 + 2 :, :, : -4 - 2] = False
    np.testing.assert_array_equal(frames(V1, V2), grown)


def test_same_images_have_no_frame():
    I = framed(speckle(U)[0])
    assert not frames(I, I).any()


def test_labels_are_told_from_the_motion_of_the_rest():
    """Labels on large structures, which are the brightest of all."""
    structures, moved = (
        0.5 + 0.2 * np.sin(x1 / 7) * np.cos(x2 / 6) + 0.05 * np.sin(x1 / 2.5 - x2 / 3)
        for x1, x2 in ((X1 + U[0], X2 + U[1]), (X1, X2))
    )
    assert suspects(labelled(structures), labelled(moved))[6:13, 8:40].all()
    found = eofm.estimate_displacement(labelled(structures), labelled(moved))
    assert found.printed[6:13, 8:40].mean() > 0.9
    assert found.printed[20:78].mean() < 0.01
    assert np.hypot(*(found.u - U))[inside()].mean() < 0.02


def test_a_clipped_part_of_a_sample_is_no_label():
    """What is very bright and hardly moves, as at a fixed edge, moves with the sample."""
    u = motion(size=3.0)
    I1, I2 = (np.clip(1.6 * I, 0, 1) for I in speckle(u))
    assert not eofm.estimate_displacement(I1, I2).printed.any()
    assert error(I1, I2, u) < 0.03
