import numpy as np
import pytest
from conftest import speckle
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.interpolate import CubicSpline

import eofm
from eofm.compiled import use_threads
from eofm.errors import InputError
from eofm.grid import inside
from eofm.imaging.gaussian import blur, gaussians
from eofm.imaging.intensity import looks_linear, normalise
from eofm.imaging.splines import Spline, evaluate, gradient, resize, resize_field, warp


def test_normalise_uses_one_map_for_both(rng):
    I1, I2 = rng.uniform(10, 20, (2, 8, 9))
    J1, J2 = normalise(I1, I2)
    assert min(J1.min(), J2.min()) == 0
    assert max(J1.max(), J2.max()) == 1
    np.testing.assert_allclose((J2 - J1) * np.ptp([I1, I2]), I2 - I1)


@given(st.floats(-1e6, 1e6), st.sampled_from(["before", "after"]))
def test_constant_image_is_refused_by_name(value, which):
    images = {"before": np.eye(8), "after": np.eye(8)}
    images[which] = np.full((8, 8), value)
    with pytest.raises(InputError, match=f"image {which} compression is constant"):
        normalise(images["before"], images["after"])


def fading(rng, power, shape=(96, 128), decay=25):
    """Amplitude (power 1) or intensity (2) of speckle that fades by some dB over the depth."""
    fade = 10 ** (-decay / 20 * np.linspace(0, 1, shape[0]))[:, None]
    field = rng.normal(size=(2, *shape)) * fade
    return np.hypot(*ndimage.gaussian_filter(field, (0, 1.2, 1.2))) ** power


@pytest.mark.parametrize("power", [1, 2])
def test_linear_intensity_is_told_from_its_logarithm(rng, power):
    """A display of the logarithm has as large a contrast where its black is near the dark parts."""
    I = fading(rng, power)
    assert looks_linear(I)
    assert looks_linear(np.stack([I] * 3))
    assert looks_linear((2.0**16 * I / I.max()).astype(np.float32))
    log = 20 * np.log10(I)
    for lowest in (0, 2, 10):
        assert not looks_linear(np.clip(log - np.percentile(log, lowest), 0, None))


def test_what_needs_no_logarithm_is_not_taken_for_linear_intensity(rng):
    phantom = eofm.Phantom(count=1500, noise=0.02)
    for settings in (eofm.Phantom(), eofm.Phantom(noise=0.03), phantom, phantom.changed(noise=0)):
        assert not looks_linear(eofm.make_phantom(np.zeros((2, 120, 180)), settings)[0])
    assert not looks_linear(fading(rng, 1, decay=5))
    assert not looks_linear(fading(rng, 1, shape=(20, 20)))
    assert not looks_linear(fading(rng, 1) - 0.1)
    assert not looks_linear(np.zeros((96, 128)))


def test_signed_integers_do_not_wrap_around():
    I = np.array([[-30000, 30000], [0, 15000]], dtype=np.int16)
    np.testing.assert_allclose(normalise(I, I)[0], [[0, 1], [0.5, 0.75]])


@pytest.mark.parametrize(
    ("I2", "message"),
    [
        (np.eye(9), "two greyscale images of one size"),
        (np.ones((8, 8, 3)), "two greyscale images"),
        (np.where(np.eye(8), np.nan, 0), "NaN or infinite"),
    ],
)
def test_arrays_that_are_no_pair_are_refused(I2, message):
    with pytest.raises(InputError, match=message):
        normalise(np.eye(8), I2)


def test_gradient_is_accurate_on_a_smooth_image():
    x2, x1 = np.mgrid[:64, :80]
    k1, k2 = 4 * np.pi / 79, 6 * np.pi / 63
    I = np.cos(k1 * x1) * np.cos(k2 * x2)
    exact = [-k1 * np.sin(k1 * x1) * np.cos(k2 * x2), -k2 * np.cos(k1 * x1) * np.sin(k2 * x2)]
    np.testing.assert_allclose(gradient(I), exact, atol=1e-4)
    np.testing.assert_allclose(gradient(I, (2, 3)) * [[[2]], [[3]]], gradient(I))


def test_spline_gradient_beats_central_differences():
    x2, x1 = np.mgrid[:40, :40]
    I = np.exp(-((x1 - 19.3) ** 2 + (x2 - 20.1) ** 2) / (2 * 1.5**2))
    exact = -(x1 - 19.3) / 1.5**2 * I
    spline = np.linalg.norm(gradient(I)[0] - exact)
    central = np.linalg.norm(np.gradient(I, axis=1) - exact)
    assert spline < central / 4


@pytest.mark.parametrize("shape", [(9, 14), (16, 16), (31, 8)])
def test_warp_by_zero_is_the_image(shape, rng):
    I = speckle(shape, rng)
    warped, kept = warp(I, np.zeros((2, *shape)))
    np.testing.assert_allclose(warped, I, atol=1e-12)
    assert kept.all()


def test_warp_marks_what_leaves_the_image():
    u = np.zeros((2, 6, 10))
    u[0] = 2.5
    _, kept = warp(np.eye(6, 10), u)
    assert kept[:, :7].all()
    assert not kept[:, 7:].any()


def test_inside_includes_the_border():
    x = np.array([[0, 9, 9.1, -0.1], [5, 0, 0, 0]])
    assert inside((6, 10), x).tolist() == [True, True, False, False]


@given(st.integers(4, 20), st.integers(4, 20), st.integers(4, 20), st.integers(4, 20))
def test_resize_keeps_corners_and_linear_functions(height, width, rows, columns):
    x2, x1 = np.meshgrid(np.linspace(0, 1, height), np.linspace(0, 2, width), indexing="ij")
    resized = resize(np.ones((height, width)), (rows, columns))
    np.testing.assert_allclose(resized, 1, atol=1e-12)
    if rows >= height and columns >= width:
        resized = resize(x1 - x2, (rows, columns))
        assert resized[0, 0] == pytest.approx(0, abs=1e-9)
        assert resized[-1, -1] == pytest.approx(1, abs=1e-9)


def test_resize_prevents_aliasing():
    I = np.tile([0.0, 1.0], (33, 16))
    assert np.ptp(resize(I, (17, 17))[:, 2:-2]) < 0.5


@given(st.integers(0, 12), st.floats(0.5, 4), st.integers(0, 2**32 - 1))
def test_gaussians_agree_with_the_dense_sum(count, sigma, seed):
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-5, 30, (2, count))
    weights = rng.normal(size=(2, count))
    x1, x2 = np.arange(25) * 1.3, np.arange(18) * 0.9
    squares = (x1[None, :, None] - centres[0]) ** 2 + (x2[:, None, None] - centres[1]) ** 2
    dense = np.einsum("ijm,km->kij", np.exp(-squares / (2 * sigma**2)), weights)
    np.testing.assert_allclose(gaussians((x1, x2), centres, sigma, weights), dense, atol=1e-6)


def test_evaluate_outside_takes_the_border_value(rng):
    I = rng.normal(size=(7, 9))
    assert evaluate(I, np.array([[-3.0], [0.0]]))[0] == pytest.approx(I[0, 0])


SHAPES = [(2, 2), (3, 5), (40, 57), (301, 240)]


@pytest.mark.parametrize("shape", SHAPES)
def test_spline_is_that_of_scipy(shape, rng):
    """Small images are filtered as a whole, large ones in strips by several threads."""
    I = rng.normal(size=shape)
    u = rng.normal(size=(2, *shape))
    x = u + np.mgrid[: shape[0], : shape[1]][::-1]
    spline = Spline(I)
    values, kept = spline.warp(u)
    expected = ndimage.map_coordinates(
        ndimage.spline_filter(I, mode="mirror"), x[::-1], mode="mirror", prefilter=False
    )
    np.testing.assert_array_equal(kept, inside(shape, x))
    np.testing.assert_allclose(values[kept], expected[kept], atol=1e-13)
    np.testing.assert_allclose(spline.evaluate(x), values, atol=1e-13)
    for axis, g in enumerate(spline.gradient()[::-1]):
        c = ndimage.spline_filter1d(I, axis=axis, mode="mirror")
        slope = ndimage.correlate1d(c, [-0.5, 0, 0.5], axis, mode="mirror")
        np.testing.assert_allclose(g, slope, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_gradient_of_a_warped_image_is_that_of_its_spline(shape, rng):
    spline = Spline(rng.normal(size=shape))
    u = rng.uniform(-0.4, 0.4, size=(2, *shape))
    values, g, kept = spline.warp_with_gradient(u, (2.0, 0.5))
    np.testing.assert_array_equal(values, spline.warp(u)[0])
    np.testing.assert_allclose(
        spline.warp_with_gradient(0 * u, (2.0, 0.5))[1], spline.gradient((2.0, 0.5)), atol=1e-12
    )
    d, g = 1e-5, g * np.reshape((2.0, 0.5), (2, 1, 1))
    for component, step in zip(g, np.reshape([[d, 0], [0, d]], (2, 2, 1, 1)), strict=True):
        (ahead, seen1), (behind, seen2) = spline.warp(u + step), spline.warp(u - step)
        use = kept & seen1 & seen2
        np.testing.assert_allclose(component[use], (ahead - behind)[use] / (2 * d), atol=1e-8)


@pytest.mark.parametrize("shape", [(30, 41), (61, 33), (90, 17), (8, 9)])
def test_resize_is_blur_and_spline(shape, rng):
    I = rng.normal(size=(61, 33))
    factors = [60 / (shape[0] - 1), 32 / (shape[1] - 1)]
    blur = [0.5 * np.sqrt(max(f**2 - 1, 0)) for f in factors]
    c = ndimage.spline_filter(ndimage.gaussian_filter(I, blur, mode="mirror"), mode="mirror")
    x = [np.arange(n) * f for n, f in zip(shape, factors, strict=True)]
    expected = ndimage.map_coordinates(
        c, np.meshgrid(*x, indexing="ij"), mode="mirror", prefilter=False
    )
    np.testing.assert_allclose(resize(I, shape), expected, atol=1e-12)


@given(st.integers(1, 40), st.integers(1, 40), st.floats(0, 30), st.floats(0, 3))
def test_blur_is_that_of_scipy(height, width, lateral, axial):
    I = np.random.default_rng(0).normal(size=(height, width))
    expected = ndimage.gaussian_filter(I, (axial, lateral), mode="mirror")
    np.testing.assert_allclose(blur(I, (lateral, axial)), expected, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_odd_spline_is_the_natural_one_of_scipy(shape, rng):
    I = rng.normal(size=shape)
    x = rng.uniform(0, 1, (2, 50)) * np.reshape(shape[::-1], (2, 1)) - 0.5
    x = x.clip(0, np.reshape(shape[::-1], (2, 1)) - 1)

    def natural(values):
        return CubicSpline(np.arange(len(values)), values, bc_type="natural")

    columns = natural(I)(x[1])
    expected = [natural(row)(at) for row, at in zip(columns, x[0], strict=True)]
    np.testing.assert_allclose(Spline(I, odd=True).evaluate(x), expected, atol=1e-12)


@given(st.integers(4, 40), st.integers(4, 40), st.integers(4, 40), st.integers(4, 40))
def test_resized_fields_keep_linear_functions(height, width, rows, columns):
    def strained(shape):
        x2, x1 = np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij")
        return np.stack([3 * x1 - x2 + 1, x1 - 2 * x2])

    resized = resize_field(strained((height, width)), (rows, columns))
    np.testing.assert_allclose(resized, strained((rows, columns)), atol=1e-10)


def test_same_bytes_with_any_number_of_threads(rng):
    I, u = rng.normal(size=(301, 240)), rng.normal(size=(2, 301, 240))
    centres, weights = rng.uniform(0, 140, (2, 200)), rng.normal(size=(1, 200))
    x1, x2 = np.arange(240.0), np.arange(301.0)
    results = []
    for threads in (1, 2, 3):
        use_threads(threads)
        spline = Spline(I)
        arrays = *spline.warp_with_gradient(u), spline.gradient(), spline.resize((320, 230))
        arrays += (gaussians((x1, x2), centres, 3.0, weights),)
        results.append([a.tobytes() for a in arrays])
    assert results[0] == results[1] == results[2]
