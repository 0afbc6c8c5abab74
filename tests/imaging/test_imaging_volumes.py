"""Volumes: the same functions in three dimensions, in single precision."""

import numpy as np
import pytest
from conftest import speckle
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.interpolate import CubicSpline
from skimage.measure import label

from eofm.compiled import use_threads
from eofm.errors import InputError
from eofm.grid import componentwise, inside
from eofm.imaging.defects import LINE, Levels, defects, filled
from eofm.imaging.gaussian import blur, gaussians
from eofm.imaging.intensity import Window, normalise, normalise_locally
from eofm.imaging.splines import (
    Spline,
    evaluate,
    evaluate_field,
    resize,
    resize_field,
    warp_field,
)

# Even, odd and unequal sides, thin ones, and enough numbers for several threads.
SHAPES = [(7, 7, 7), (8, 12, 9), (3, 40, 57), (31, 3, 16), (24, 60, 3), (34, 45, 67)]
THIN = [(1, 9, 12), (9, 1, 12), (9, 12, 1), (2, 2, 2), (1, 1, 1)]
SINGLE = 4e-6


def noise(shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def positions(shape):
    return np.indices(shape)[::-1].astype(np.float64)


@pytest.mark.parametrize("shape", SHAPES)
def test_spline_is_that_of_scipy(shape):
    I, u = noise(shape), 0.7 * noise((3, *shape), 1)
    x = u + positions(shape)
    values, kept = Spline(I).warp(u)
    assert values.dtype == np.float32
    c = ndimage.spline_filter(I.astype(np.float64), mode="mirror")
    expected = ndimage.map_coordinates(c, x[::-1], mode="mirror", prefilter=False)
    np.testing.assert_array_equal(kept, inside(shape, x))
    np.testing.assert_allclose(values[kept], expected[kept], atol=SINGLE)
    np.testing.assert_allclose(evaluate(I, x), values, atol=SINGLE)
    clipped = x.clip(0, componentwise(shape[::-1], 3) - 1)
    np.testing.assert_allclose(evaluate(I, clipped), values, atol=SINGLE)


@pytest.mark.parametrize("shape", SHAPES + THIN)
def test_warp_by_zero_is_the_volume(shape):
    I = noise(shape)
    values, g, kept = Spline(I).warp_with_gradient(np.zeros((3, *shape)))
    np.testing.assert_allclose(values, I, atol=SINGLE)
    np.testing.assert_allclose(g, Spline(I).gradient(), atol=SINGLE)
    assert kept.all()


@pytest.mark.parametrize("shape", SHAPES)
def test_gradients_are_finite_differences(shape):
    spline, spacing = Spline(noise(shape)), (2.0, 0.5, 1.5)
    # Away from samples, where the third derivative jumps.
    u = np.random.default_rng(2).uniform(0.1, 0.4, (3, *shape))
    values, g, _ = spline.warp_with_gradient(u, spacing)
    np.testing.assert_array_equal(values, spline.warp(u)[0])
    x = u + positions(shape)
    at, slopes = spline.evaluate_with_gradient(x)
    np.testing.assert_allclose(at, values, atol=SINGLE)
    kept = inside(shape, x + 0.1) & inside(shape, x - 0.1)
    # Between samples it is a cubic, of which two such differences give the slope.
    for component, h, step in zip(g, spacing, np.eye(3), strict=True):
        step = componentwise(step, 3)
        near, far = (
            (spline.evaluate(x + d * step) - spline.evaluate(x - d * step)) / (2 * d)
            for d in (0.05, 0.1)
        )
        expected = (4 * near.astype(np.float64) - far) / 3
        np.testing.assert_allclose(h * component[kept], expected[kept], atol=2e-4)
    np.testing.assert_allclose(slopes, g * componentwise(spacing, 3), atol=5 * SINGLE)


@pytest.mark.parametrize("shape", SHAPES + THIN)
def test_runs_of_neighbours_get_what_each_gets_alone(shape):
    """Smooth motions are followed row by row, up to the last coefficients."""
    spline, u = Spline(noise(shape)), affine(shape).astype(np.float32)
    values, g, kept = spline.warp_with_gradient(u)
    alone, slopes = spline.evaluate_with_gradient(u + positions(shape))
    np.testing.assert_array_equal(values, alone)
    np.testing.assert_array_equal(g, slopes)
    np.testing.assert_array_equal(spline.evaluate(u + positions(shape)), alone)
    np.testing.assert_array_equal(spline.warp(u)[0], values)
    np.testing.assert_array_equal(kept, inside(shape, u + positions(shape)))


@pytest.mark.parametrize("shape", SHAPES)
def test_odd_spline_is_the_natural_one_of_scipy(shape):
    I = noise(shape)
    x = np.random.default_rng(3).uniform(0, 1, (3, 40)) * (np.reshape(shape[::-1], (3, 1)) - 1)

    def natural(values, at):
        return CubicSpline(np.arange(len(values)), values, bc_type="natural")(at)

    expected = [natural(natural(natural(I, x3).astype(float), x2), x1) for x1, x2, x3 in x.T]
    np.testing.assert_allclose(Spline(I, odd=True).evaluate(x), expected, atol=SINGLE)


def affine(shape, at=None):
    x = np.indices(shape)[::-1] if at is None else at
    A = np.array([[0.03, -0.02, 0.01], [0.02, -0.04, 0.03], [-0.01, 0.02, 0.05]])
    return np.tensordot(A, x, 1) + componentwise([1, -2, 0.5], x.ndim - 1)


@pytest.mark.parametrize("shape", SHAPES + THIN)
def test_affine_fields_stay_so(shape):
    u = affine(shape)
    x = np.random.default_rng(4).uniform(0, 1, (3, 60)) * (np.reshape(shape[::-1], (3, 1)) - 1)
    np.testing.assert_allclose(evaluate_field(u, x), affine(shape, x), atol=SINGLE)
    by = 0.3 * np.sin(positions(shape))
    moved = (positions(shape) + by).clip(0, componentwise(shape[::-1], 3) - 1)
    np.testing.assert_allclose(warp_field(u, by), affine(shape, moved), atol=SINGLE)
    if min(shape) > 1:
        new = tuple(2 * n - 1 for n in shape)
        expected = affine(new, positions(new) / 2)
        np.testing.assert_allclose(resize_field(u, new), expected, atol=SINGLE)
        new = tuple(n // 2 + 2 for n in shape)
        at = positions(new) * componentwise(
            [(n - 1) / (m - 1) for n, m in zip(shape, new, strict=True)][::-1], 3
        )
        np.testing.assert_allclose(resize_field(u, new), affine(new, at), atol=SINGLE)


def test_warping_is_linear_in_the_volume():
    shape = (9, 14, 11)
    I, J, u = noise(shape), noise(shape, 1), noise((3, *shape), 2)
    both = Spline(2 * I - 3 * J).warp(u)[0]
    np.testing.assert_allclose(
        both, 2 * Spline(I).warp(u)[0] - 3 * Spline(J).warp(u)[0], atol=5 * SINGLE
    )


@pytest.mark.parametrize("width", [0.6, (0.0, 2.0, 5.0)])
@pytest.mark.parametrize("shape", SHAPES + THIN)
def test_blur_is_that_of_scipy(shape, width):
    I = noise(shape)
    std = np.broadcast_to(width, 3)[::-1]
    expected = ndimage.gaussian_filter(I.astype(np.float64), std, mode="mirror")
    blurred = blur(I, width)
    assert blurred.dtype == np.float32
    np.testing.assert_allclose(blurred, expected, atol=SINGLE)


def test_blur_is_its_own_adjoint_where_ends_weigh_half():
    shape = (9, 22, 37)
    weights = np.ones(shape)
    for axis in range(3):
        ends = np.moveaxis(weights, axis, 0)
        ends[0] /= 2
        ends[-1] /= 2
    I, J = noise(shape), noise(shape, 1)
    one = (weights * J * blur(I, (2.0, 1.0, 0.5))).sum()
    assert one == pytest.approx((weights * I * blur(J, (2.0, 1.0, 0.5))).sum(), abs=1e-4)


@pytest.mark.parametrize("new", [(5, 17, 20), (16, 40, 30), (31, 9, 60)])
def test_resize_is_blur_and_spline(new):
    old = (16, 33, 39)
    I = noise(old)
    factors = [(n - 1) / (m - 1) for n, m in zip(old, new, strict=True)]
    std = [0.5 * np.sqrt(max(f**2 - 1, 0)) for f in factors]
    c = ndimage.spline_filter(
        ndimage.gaussian_filter(I.astype(np.float64), std, mode="mirror"), mode="mirror"
    )
    x = np.meshgrid(*(np.arange(n) * f for n, f in zip(new, factors, strict=True)), indexing="ij")
    expected = ndimage.map_coordinates(c, x, mode="mirror", prefilter=False)
    np.testing.assert_allclose(resize(I, new), expected, atol=SINGLE)
    out = np.empty(new, np.float32)
    assert Spline(I).resize(new, out) is out
    np.testing.assert_allclose(out, expected, atol=SINGLE)


@given(st.integers(0, 12), st.floats(0.5, 4), st.integers(0, 2**32 - 1))
def test_gaussians_agree_with_the_dense_sum(count, sigma, seed):
    rng = np.random.default_rng(seed)
    centres, weights = rng.uniform(-5, 25, (3, count)), rng.normal(size=(2, count))
    axes = np.arange(15) * 1.3, np.arange(18) * 0.9, np.arange(11) * 1.1
    x1, x2, x3 = (x[..., None] - c for x, c in zip(axes, centres, strict=True))
    squares = x3[:, None, None] ** 2 + x2[:, None] ** 2 + x1**2
    dense = np.exp(-squares / (2 * sigma**2)) @ weights.T
    found = gaussians(axes, centres, sigma, weights)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, np.moveaxis(dense, -1, 0), atol=SINGLE)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_volumes_of_equal_slices_are_images(axis):
    """One code: what is constant along an axis gives what an image gives."""
    shape = (23, 31)
    I, u = speckle(shape, np.random.default_rng(0)), 0.6 * noise((2, *shape), 1)
    used = np.random.default_rng(1).random(shape) < 0.8

    def thick(f):
        return np.repeat(np.expand_dims(f, f.ndim - 2 + axis), 12, f.ndim - 2 + axis)

    flat = [c for c in range(3) if c != 2 - axis]
    u3 = np.zeros((3, *thick(I).shape))
    u3[flat] = thick(u)
    plane, volume = Spline(I), Spline(thick(I))
    for odd in (False, True):
        pairs = [
            (Spline(I, odd).warp(u)[0], Spline(thick(I), odd).warp(u3)[0]),
            (plane.gradient(), volume.gradient()[flat]),
            (plane.warp_with_gradient(u)[1], volume.warp_with_gradient(u3)[1][flat]),
            (blur(I, 1.2), blur(thick(I), 1.2)),
            (
                normalise_locally(I, (4, 3)),
                normalise_locally(thick(I), tuple(np.insert((4.0, 3.0), 2 - axis, 5.0))),
            ),
            (Window(used, 5.0).mean(I), Window(thick(used), 5.0).mean(thick(I))),
        ]
        for expected, found in pairs:
            np.testing.assert_allclose(found, thick(expected), atol=1e-5)
    assert abs(volume.warp_with_gradient(u3)[1][2 - axis]).max() < 1e-5
    new = np.insert((30, 16), axis, 7)
    np.testing.assert_allclose(
        resize(thick(I), tuple(new)),
        np.repeat(np.expand_dims(resize(I, (30, 16)), axis), 7, axis),
        atol=1e-5,
    )


def test_same_bytes_with_any_number_of_threads():
    shape = (40, 57, 66)
    I, u = noise(shape), noise((3, *shape), 1)
    rng = np.random.default_rng(2)
    centres, weights = rng.uniform(0, 60, (3, 200)), rng.normal(size=(1, 200))
    axes = [np.arange(float(n)) for n in shape[::-1]]
    around = rng.random(shape) < 0.9
    results = []
    for threads in (1, 2, 3):
        use_threads(threads)
        arrays = [gaussians(axes, centres, 2.0, weights), blur(I, 2.0)]
        arrays += [Window(around, width).mean(I) for width in (4.0, 7.0)]
        for odd in (False, True):
            spline = Spline(I, odd)
            arrays += [*spline.warp_with_gradient(u), *spline.warp(u), spline.gradient()]
            arrays += [spline.resize((30, 70, 40)), spline.evaluate(40 * u)]
        results.append([a.tobytes() for a in arrays])
    assert results[0] == results[1] == results[2]


def test_normalise_uses_one_map_for_both():
    I1, I2 = np.random.default_rng(0).integers(-30000, 30000, (2, 5, 8, 9)).astype(np.int16)
    kept = I1.copy()
    J1, J2 = normalise(I1, I2)
    assert J1.dtype == J2.dtype == np.float32
    low, high = min(I1.min(), I2.min()), max(I1.max(), I2.max())
    for I, J in ((I1, J1), (I2, J2)):
        np.testing.assert_allclose(J, (I.astype(float) - low) / (float(high) - low), atol=1e-6)
    np.testing.assert_array_equal(I1, kept)
    # A small signal on a large offset is not lost in single precision.
    I = 1e9 + np.random.default_rng(1).random((4, 6, 7))
    np.testing.assert_allclose(normalise(I, I)[0], (I - I.min()) / np.ptp(I), atol=1e-6)


@pytest.mark.parametrize(
    ("I2", "message"),
    [
        (np.ones((4, 4, 5)), "two volumes of one size"),
        (np.eye(4), "two greyscale images or volumes of one size"),
        (np.ones((4, 4, 4)), "the volume after compression is constant"),
        (np.full((4, 4, 4), np.inf), "a volume has NaN or infinite values"),
    ],
)
def test_arrays_that_are_no_pair_are_refused(I2, message):
    with pytest.raises(InputError, match=message):
        normalise(noise((4, 4, 4)), I2)


@pytest.mark.parametrize("width", [3.0, 4.0, 8.0])
def test_windows_average_over_the_mask(width):
    shape = (20, 33, 41)
    used = np.random.default_rng(0).random(shape) < 0.7
    I, J = 1 + 0.3 * noise(shape), noise(shape, 1)
    around = Window(used, width)
    sums, share = (
        ndimage.gaussian_filter(np.where(used, f, 0.0), width, mode="constant", truncate=4.5)
        for f in (I * J, np.ones(shape))
    )
    found = around.mean(I, J)
    np.testing.assert_allclose(found, sums / share, atol=0.02)
    np.testing.assert_allclose(found, around.mean(I * J), atol=1e-6)
    np.testing.assert_allclose(around.mean(np.full(shape, 3.0)), 3, rtol=1e-6)


def sample_with(bright):
    """A smooth sample in which some pixels are as bright as it gets."""
    I = speckle(bright.shape, np.random.default_rng(0)).astype(np.float32)
    return np.where(bright, I.max(), I)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_saturated_lines_are_defects(axis):
    shape = (40, 42, 44)
    bright = np.zeros(shape, dtype=bool)
    lines = np.moveaxis(bright, axis, 0)
    lines[3 : 3 + LINE, 20, 9] = True
    lines[2 : 1 + LINE, 9, 25] = True  # too short
    I = sample_with(bright)
    found = Levels.of(I).marked(I)
    expected = np.zeros(shape, dtype=bool)
    np.moveaxis(expected, axis, 0)[3 : 3 + LINE, 20, 9] = True
    np.testing.assert_array_equal(found, expected)


def test_highlights_are_defects_and_filled():
    shape = (20, 24, 22)
    I = sample_with(np.zeros(shape, dtype=bool))
    assert not defects(I).any()
    assert filled(I, defects(I)) is I
    I[10, 11, 12] = 40
    dead = defects(I)
    assert label(dead).max() == 1
    assert dead[10, 11, 12]
    assert dead.sum() == 25
    J = filled(I, dead)
    np.testing.assert_array_equal(J[~dead], I[~dead])
    for at in np.argwhere(dead):
        near = np.argwhere(~dead)
        distance = ((near - at) ** 2).sum(1)
        nearest = near[distance == distance.min()]
        assert J[tuple(at)] in I[tuple(nearest.T)]


@pytest.mark.parametrize("structures", ["large", "few"])
def test_highlights_may_be_most_of_the_maxima_of_a_volume(structures, rng):
    shape = (32, 36, 40)
    if structures == "large":
        I = 1 + 0.3 * ndimage.gaussian_filter(rng.normal(size=shape), 4) * 4**1.5
    else:
        I = np.zeros(shape)
        I[tuple(rng.integers(0, n, 60) for n in shape)] = rng.uniform(20, 40, 60)
        I = ndimage.gaussian_filter(I, 1.3)
    assert not defects(I).any()
    lights = np.zeros(shape, dtype=bool)
    lights[tuple(rng.integers(4, n - 4, 25) for n in shape)] = True
    lights = ndimage.maximum_filter(lights, 2)
    found = defects(np.where(lights, 8 * I.max(), I))
    assert found[lights].all()
    assert found.mean() < 0.1


@pytest.mark.parametrize("shape", [(60, 70), (64, 41), (9, 64, 41), (50, 40, 8)])
def test_lines_are_those_of_an_opening(shape):
    """Of images and volumes: runs of 32 saturated pixels and more."""
    rng, bright = np.random.default_rng(4), np.zeros(shape, dtype=bool)
    for length in range(LINE - 8, LINE + 4):
        segment = np.moveaxis(bright, rng.integers(len(shape)), 0)
        start = rng.integers(-4, max(1, len(segment) - 10))
        line = (slice(max(start, 0), start + length), *rng.integers(segment.shape[1:]))
        segment[line] = True
    found = np.zeros(shape, dtype=bool)
    for axis in range(len(shape)):
        line = np.ones([LINE if k == axis else 1 for k in range(len(shape))])
        found |= ndimage.binary_opening(bright, line)
    assert 0 < found.mean() < 0.05
    I = sample_with(bright)
    np.testing.assert_array_equal(Levels.of(I).marked(I), found)
