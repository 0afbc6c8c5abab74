"""Lines of detectors: what stays, or flickers, in whole rows or columns of both images."""

import numpy as np
import pytest
from test_robust import SHAPE, motion, speckle

import eofm
import eofm.flow.detector
from eofm.flow.detector import without_lines_that_stay
from eofm.flow.likeness import left
from eofm.imaging.flicker import flickers, level, without_changes
from eofm.imaging.lines import Lines, lines, means_along, without

U = motion(size=4.0) + 1.0
NONE = np.zeros(SHAPE, dtype=bool)
INNER = slice(12, -12), slice(12, -12)


def everywhere(n):
    return 0.08 * np.random.default_rng(3).normal(size=n)


def few(n):
    p = np.zeros(n)
    p[[20, 45, 46, 70]] = 0.3, -0.25, 0.2, 0.35
    return p


def error(I1, I2, u):
    found = eofm.estimate_displacement(I1, I2)
    return np.hypot(*(found.u - u))[INNER].mean(), found


@pytest.mark.parametrize("gain", [1.0, 0.7])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("pattern", [everywhere, few])
def test_lines_are_taken_off(pattern, axis, gain):
    I1, I2 = speckle(U)
    p = np.expand_dims(pattern(SHAPE[axis]), 1 - axis)
    J1, J2 = I1 + p, gain * (I2 + p)
    off, found = error(J1, J2, U)
    clean, other = error(I1, gain * I2, U)
    assert found.lines == (axis,)
    assert other.lines == ()
    assert clean < 0.01
    assert off < 0.03
    assert found.trust.verdict == "good"


def test_the_lines_are_those_that_were_added():
    I1, I2 = speckle(U)
    for pattern in (everywhere, few):
        p = pattern(SHAPE[1])
        (line,) = lines(means_along(I1 + p, I2 + p, NONE), pattern is few)
        left = line.before.ravel() - p
        assert line.axis == 1
        assert left.std() < 0.4 * p.std()
        J1, J2 = without((line,), I1 + p, I2 + p)
        np.testing.assert_allclose(J1 - I1, -(np.broadcast_to(left, SHAPE)), atol=1e-12)
        np.testing.assert_allclose(J1 - I1, J2 - I2, atol=1e-12)


def test_speckle_has_no_lines():
    for seed in range(6):
        I1, I2 = speckle(motion(size=seed / 3), seed=seed)
        assert not any(lines(means_along(I1, I2, NONE), single) for single in (True, False))


@pytest.mark.parametrize("u1", [0.0, 2.0])
def test_layers_of_the_sample_are_no_lines(u1):
    """Layers that move along themselves stay, and such that hardly move nearly do."""
    x2 = np.arange(SHAPE[0], dtype=float)[:, None]
    u = np.stack([np.full(SHAPE, u1), np.broadcast_to(0.3 + 0.002 * x2, SHAPE)])

    def layers(x):
        return 0.3 * np.sin(x / 2) * np.sin(x / 3.3)

    I1, I2 = speckle(u)
    J1, J2 = I1 + layers(x2 + u[1]), I2 + layers(x2)
    assert lines(means_along(J1, J2, NONE), single=False)
    off, found = error(J1, J2, u)
    assert found.lines == ()
    assert off < 0.03


@pytest.mark.parametrize("moves", [True, False])
def test_what_the_field_carries_along_is_not_looked_at_twice(rng, moves):
    x2 = np.arange(SHAPE[0], dtype=float)[:, None]
    u = np.stack([np.full(SHAPE, 2.0), np.broadcast_to(0.7 + 0.01 * x2, SHAPE)])
    k, phase = rng.normal(0, 0.3, (40, 1, 1)), rng.uniform(0, 2 * np.pi, (40, 1, 1))

    def layers(x):
        return 0.05 * np.cos(k * x + phase).sum(0)

    I1, I2 = speckle(u)
    J1, J2 = I1 + layers(x2 + u[1] if moves else x2), I2 + layers(x2)
    assert any(lines(means_along(J1, J2, NONE), single) for single in (True, False))
    found, seen = eofm.estimate_displacement(I1, I2), []

    def estimate(*images):
        seen.append(images)
        return found

    told, _ = without_lines_that_stay((J1, J2), NONE, found, estimate)
    assert bool(seen) != moves
    assert (told.lines == ()) == moves


def test_where_lines_taken_before_no_longer_stay_the_search_ends(monkeypatch):
    """The same lines would be taken off for ever."""
    p = everywhere(SHAPE[0])[:, None]
    line, (I1, I2), seen = Lines(0, p, p), speckle(U), []
    found = eofm.estimate_displacement(I1, I2)

    def parts(I1, I2, dead, u, doubted):
        return np.array([0.1, 1.0] if len(doubted) == 2 else [1.0])

    def estimate(*images):
        seen.append(images)
        assert len(seen) < 5
        return found

    monkeypatch.setattr(eofm.flow.detector, "lines", lambda means, single: (line,))
    monkeypatch.setattr(eofm.flow.detector, "changes", parts)
    told, _ = without_lines_that_stay((I1 + p, I2 + p), NONE, found, estimate)
    assert told.lines == (0,)
    assert len(seen) == 2


def test_saturated_lines_are_no_lines_of_a_detector():
    """Nothing is below them: they are left out instead."""
    I1, I2 = (I.copy() for I in speckle(U))
    for I in (I1, I2):
        I[40:42] = 1.5
    assert not any(lines(means_along(I1, I2, NONE), single) for single in (True, False))
    off, found = error(I1, I2, U)
    assert found.lines == ()
    assert off < 0.05


def test_lines_of_volumes(rng):
    V1, V2 = (rng.uniform(0, 1, (10, 24, 28)).astype(np.float32) for _ in range(2))
    p = rng.normal(size=24)[:, None]
    means = means_along(V1 + p, V2 + p, np.zeros(V1.shape, dtype=bool))
    (line,) = lines(means, single=False)
    assert line.axis == 1
    assert line.before.shape == (1, 24, 1)
    assert np.corrcoef(line.before.ravel(), p.ravel())[0, 1] > 0.99


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("kind", ["added", "multiplied"])
def test_lines_that_flicker_are_taken_off(kind, axis):
    rng = np.random.default_rng(5)
    I1, I2 = speckle(U)

    def flickering(I):
        line = np.expand_dims(rng.normal(0, 0.15, SHAPE[axis]), 1 - axis)
        return I + line * I.std() if kind == "added" else I * (1 + line)

    off, found = error(flickering(I1), flickering(I2), U)
    assert found.lines == (axis,)
    assert off < 0.03
    assert found.trust.verdict == "good"


@pytest.mark.parametrize("axis", [0, 2])
def test_slices_that_flicker_are_taken_off(rng, axis):
    shape = (14, 30, 33)
    x3, x2, x1 = np.mgrid[: shape[0], : shape[1], : shape[2]]
    u = np.stack([0.4 + 0.02 * x1, 1 - 0.03 * x2, 0.3 * np.sin(x2 / 12) + 0.01 * x3])
    look = eofm.Phantom(count=500, sigma=(1.3, 1.3), seed=2)
    V1, V2, _ = eofm.make_phantom(u.astype(np.float32), look)

    def error(V1, V2):
        found = eofm.estimate_displacement(V1, V2, eofm.Estimation(alpha=1.0))
        return np.linalg.norm(found.u - u, axis=0).mean(), found

    def flickering(V):
        gain = 1 + 0.15 * rng.normal(size=shape[axis])
        return (V * np.expand_dims(gain, [k for k in range(3) if k != axis])).astype(np.float32)

    clean, steady = error(V1, V2)
    off, found = error(flickering(V1), flickering(V2))
    assert (steady.lines, found.lines) == ((), (axis,))
    assert clean < 0.015
    assert off < 0.03
    assert found.trust.verdict == "good"


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_no_line_flickers_in_speckle_or_in_layers_that_move(rng, noise):
    x2 = np.arange(SHAPE[0], dtype=float)[:, None]
    for seed in range(3):
        u = motion(size=1.0 + seed)
        I1, I2 = speckle(u, seed=seed)
        I1, I2 = I1 + 0.3 * np.sin((x2 + u[1]) / 2), I2 + 0.3 * np.sin(x2 / 2)
        seen = (I + noise * rng.normal(size=SHAPE) for I in (I1, I2))
        rest, used, _ = left(*seen, NONE, u)
        assert flickers(I1[used] - I1[used].mean(), rest, used) == ()


def test_shading_does_not_flicker():
    """What changes smoothly from line to line is left to the fit of brightness."""
    I1, I2 = speckle(U)
    rest, used, _ = left(I1, I2 * np.linspace(1.2, 0.6, SHAPE[1]), NONE, U)
    assert flickers(I1[used] - I1[used].mean(), rest, used) == ()


def test_what_flickers_is_told_for_each_image(rng):
    """As the motion varies along lines; and nothing is taken off where nothing does."""
    I1, I2 = speckle(U)
    p1, p2 = 0.1 * rng.normal(size=(2, SHAPE[0], 1))
    for add1, add2 in ((p1, p2), (0 * p1, 0 * p2)):
        J1, J2 = I1 + add1, I2 + add2
        rest, used, _ = left(J1, J2, NONE, U)
        seen = J1[used] - J1[used].mean() - rest / 2
        K1, K2 = without_changes((J1, J2), seen, rest, used, U, 0)
        left_over = left(K1, K2, NONE, U)[0].std()
        assert left_over < max(0.25 * rest.std(), 1.01 * left(I1, I2, NONE, U)[0].std())


def test_level_lines_have_one_mean_and_one_contrast(rng):
    I, dead = rng.normal(size=(30, 40)) * rng.uniform(1, 2, (30, 1)), NONE[:30, :40].copy()
    dead[3:9, 5:11] = True
    I[dead] = 50.0
    live = np.ma.masked_array(level(I, 0, dead), dead)
    np.testing.assert_allclose(live.mean(1), I[~dead].mean())
    np.testing.assert_allclose(live.std(1), live.std(1)[0])


def test_lines_do_not_explain_images_that_show_different_things():
    """Where structures are large and the image is small, parts of lines share much by chance."""
    sample = eofm.Sample(height=40, width=60, compression=2)
    phantom = eofm.Phantom(count=150, sigma=(1.5, 2.0), seed=1)
    I1, I2, _ = eofm.make_phantom(eofm.true_field(sample), phantom)
    found = eofm.estimate_displacement(I1, I2[::-1, ::-1])
    assert found.lines == ()
    assert found.trust.verdict != "good"
