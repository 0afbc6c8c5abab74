"""Strain from displacement."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import ndimage

from eofm.analysis.tensors import Measure, measured, pairs
from eofm.errors import InputError
from eofm.grid import Array, precision

Filter = Callable[[Array, int, float], Array]

# What the derivative is called in summaries.
FILTER = "local linear least squares with Gaussian weights"


# Lines of pixels that are filtered at a time, in double precision.
LINES = 32


def strain(
    u: Array, pixel_size: Sequence[float], window: float, measure: Measure = "small"
) -> Array:
    """Strain of a displacement field.

    Parameters
    ----------
    u : ndarray, shape (2, height, width) or (3, depth, height, width)
        Displacement, px.
    pixel_size : (lateral, axial) or (lateral, axial, elevational)
        Sides of a pixel, um; of an image two count.
    window : float
        Standard deviation of the Gaussian weights, um.
    measure : {"small", "green-lagrange", "almansi", "hencky"}
        See `eofm.analysis.tensors`.

    Returns
    -------
    ndarray, shape (3, height, width) or (6, depth, height, width)
        e11 (lateral), e22 (axial; negative under compression), e33 (elevational), then the shear
        strains e12, e13, e23, without unit. Of small strains, ``e11 = d1 u1`` and
        ``e12 = (d1 u2 + d2 u1) / 2``.

    Raises
    ------
    InputError
        If the window is narrower than half a pixel.

    Notes
    -----
    Each derivative is the slope of the line that fits the displacement best around a
    pixel. Up to the edges it is exact for displacements that are linear. Gaussian weights
    are products, so the fit is a mean across the line and a slope along it.
    """
    n = len(u)
    sides = pixel_size[:n]
    widths = [window / p for p in sides]
    if min(widths) < 0.5:
        raise InputError(
            f"strain_window: {window:g} um is less than half a pixel"
            f" ({' x '.join(f'{p:g}' for p in sides)} um); a few pixels are usual"
        )

    def derivative(i: int, j: int) -> Array:
        """Slope of u_i along x_j, of its means across the other directions."""
        f = u[i]
        for k in (k for k in range(n) if k != j):
            f = _filtered(_mean, f, n - 1 - k, widths[k])
        f = _filtered(_slope, f, n - 1 - j, widths[j])
        f *= sides[i] / sides[j]
        return f

    if measure != "small":
        G = np.stack([np.stack([derivative(i, j) for j in range(n)]) for i in range(n)])
        return measured(G, measure)
    e = np.empty((len(pairs(n)), *u.shape[1:]), precision(n))
    for out, (i, j) in zip(e, pairs(n), strict=True):
        out[:] = derivative(j, i)
        if i != j:
            out += derivative(i, j)
            out /= 2
    return e


def _filtered(filter: Filter, f: Array, axis: int, width: float) -> Array:
    """A filter along an axis, some lines at a time."""
    g = np.empty(f.shape, precision(f.ndim))
    across = int(axis == 0)
    for first in range(0, f.shape[across], LINES):
        part = (slice(None),) * across + (slice(first, first + LINES),)
        g[part] = filter(f[part].astype(np.float64), axis, width)
    return g


def _sum(f: Array, axis: int, width: float) -> Array:
    """Sum along an axis under a Gaussian that ends at the border."""
    return ndimage.gaussian_filter1d(f, width, axis, mode="constant")


def _along(values: Array, axis: int, ndim: int) -> Array:
    """Values along an axis of an image."""
    return values.reshape([-1 if k == axis else 1 for k in range(ndim)])


def _mean(f: Array, axis: int, width: float) -> Array:
    """Mean along an axis per sample."""
    return _sum(f, axis, width) / _along(_sum(np.ones(f.shape[axis]), 0, width), axis, f.ndim)


def _slope(f: Array, axis: int, width: float) -> Array:
    """Slope along an axis per sample, from its moments."""
    # Centred positions keep the differences of moments well conditioned.
    x = np.linspace(-1, 1, f.shape[axis])
    weight, first, second = (_along(_sum(x**k, 0, width), axis, f.ndim) for k in (0, 1, 2))
    moment = _sum(_along(x, axis, f.ndim) * f, axis, width)
    covariance = weight * moment - first * _sum(f, axis, width)
    return covariance / (weight * second - first**2) * 2 / (f.shape[axis] - 1)
