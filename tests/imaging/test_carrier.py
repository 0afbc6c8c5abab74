"""The carrier of images that oscillate, and its amplitude."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.signal import hilbert

from eofm.imaging.carrier import amplitude, has_carrier

SHAPES = [(64, 80), (81, 47), (32, 36, 41)]


def lines(shape, axis, period):
    """Speckle about a carrier along an axis, as radio-frequency lines are."""
    noise = np.random.default_rng(4).normal(size=(2, *shape))
    slow = [gaussian_filter(f, 0.7 * period) for f in noise]
    along = [-1 if a == axis else 1 for a in range(len(shape))]
    wave = np.exp(2j * np.pi * np.arange(shape[axis]) / period).reshape(along)
    return np.real((slow[0] + 1j * slow[1]) * wave)


@pytest.mark.parametrize("shape", SHAPES)
def test_radio_frequency_has_a_carrier_along_any_axis(shape):
    for axis in range(len(shape)):
        I = lines(shape, axis, 5.0)
        assert has_carrier(I)
        assert has_carrier(3 * I + 100)
        assert not has_carrier(amplitude(I))


@pytest.mark.parametrize("shape", SHAPES)
def test_speckle_noise_and_slopes_have_none(shape):
    random = np.random.default_rng(1)
    for width in (0.0, 0.7, 2.0, 5.0):
        noise = gaussian_filter(random.normal(size=(2, *shape)), (0, *[width] * len(shape)))
        speckle = np.hypot(*noise)
        slope = np.linspace(0, 5, shape[-1])
        for I in (noise[0], speckle, np.log(speckle + 1e-3), speckle + slope):
            assert not has_carrier(I)


def test_too_small_images_have_none():
    assert not has_carrier(lines((12, 90), 1, 4.0))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_the_amplitude_of_a_wave_is_its_own_in_every_direction(shape, precision):
    turns = np.array([3, 5, 4][: len(shape)])
    phase = sum(
        2 * np.pi * k * x / n for k, x, n in zip(turns, np.indices(shape), shape, strict=True)
    )
    found = amplitude((0.7 * np.cos(phase) + 2.0).astype(precision))
    assert found.dtype == precision
    np.testing.assert_allclose(found, 0.7, rtol=1e-4)


def test_the_amplitude_of_lines_is_their_envelope():
    I = lines((120, 60), 0, 5.0)
    inner = slice(10, -10), slice(10, -10)
    found, envelope = amplitude(I)[inner], np.abs(hilbert(I, axis=0))[inner]
    assert np.corrcoef(found.ravel(), envelope.ravel())[0, 1] > 0.99
