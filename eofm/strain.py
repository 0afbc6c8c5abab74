"""Strain from displacement."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from eofm.errors import InputError

Array = NDArray[np.float64]

# What the derivative is called in summaries.
FILTER = "local linear least squares with Gaussian weights"


def strain(u: Array, pixel_size: tuple[float, float], window: float) -> Array:
    """Linearised strain of a displacement field.

    Parameters
    ----------
    u : ndarray, shape (2, height, width)
        Displacement, px.
    pixel_size : (lateral, axial)
        Sides of a pixel, um.
    window : float
        Standard deviation of the Gaussian weights, um.

    Returns
    -------
    ndarray, shape (3, height, width)
        ``e11 = d1 u1`` (lateral), ``e22 = d2 u2`` (axial; negative under compression) and
        ``e12 = (d1 u2 + d2 u1) / 2`` (shear), without unit.

    Raises
    ------
    InputError
        If the window is narrower than half a pixel.

    Notes
    -----
    Each derivative is the slope of the line that fits the displacement best around a
    pixel. Up to the edges it is exact for displacements that are linear.
    """
    widths = [window / p for p in pixel_size]
    if min(widths) < 0.5:
        raise InputError(
            f"strain_window: {window:g} um is less than half a pixel"
            f" ({pixel_size[0]:g} x {pixel_size[1]:g} um); a few pixels are usual"
        )

    def derivative(i: int, j: int) -> Array:
        return _slope(u[i] * pixel_size[i], 1 - j, widths) / pixel_size[j]

    shear = (derivative(1, 0) + derivative(0, 1)) / 2
    return np.stack([derivative(0, 0), derivative(1, 1), shear])


def _slope(f: Array, axis: int, widths: list[float]) -> Array:
    """Slope along an axis per sample, from moments under a Gaussian that ends at the border."""

    def moment(g: Array) -> Array:
        return ndimage.gaussian_filter(g, widths[::-1], mode="constant")

    shape = [1, 1]
    shape[axis] = f.shape[axis]
    # Centred positions keep the differences of moments well conditioned.
    x = np.broadcast_to(np.linspace(-1, 1, f.shape[axis]).reshape(shape), f.shape)
    weight, mean_x, mean_f = moment(np.ones_like(f)), moment(x), moment(f)
    covariance = moment(x * f) * weight - mean_x * mean_f
    variance = moment(x * x) * weight - mean_x**2
    return covariance / variance * 2 / (f.shape[axis] - 1)
