"""Images as functions: normalise, resize, differentiate and evaluate them.

Images are float64 arrays of shape (height, width). Fields have shape (2, height,
width): component 0 is lateral (along columns), component 1 axial (along rows, down).
An image covers ``[0, width - 1] x [0, height - 1]``, its samples being the nodes of a
grid, so that a coarser image of the same sample has the same corners.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]

# Cubic splines: linear interpolation is 8 times less accurate on speckle.
ORDER = 3


def normalise(I1: Array, I2: Array, limits: tuple[float, float] | None = None) -> tuple[Array, Array]:
    """Map two images to [0, 1] by one affine map, so that brightness stays comparable.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width)
        Images before and after compression.
    limits : (low, high), optional
        Intensities that become 0 and 1; by default the extremes of both images.

    Raises
    ------
    ValueError
        If there is no contrast to normalise.
    """
    low, high = limits or (min(I1.min(), I2.min()), max(I1.max(), I2.max()))
    if not high > low:
        raise ValueError(f"the images are constant (intensity {low:g}): nothing to follow")
    return (I1 - low) / (high - low), (I2 - low) / (high - low)


def gradient(I: Array, spacing: tuple[float, float] = (1.0, 1.0)) -> Array:
    """Gradient of the cubic spline through an image, shape (2, height, width).

    ``spacing`` holds the lateral and the axial distance of the samples.
    """

    def derivative(axis: int) -> Array:
        c = ndimage.spline_filter1d(I, ORDER, axis, mode="mirror")
        return ndimage.correlate1d(c, [-0.5, 0, 0.5], axis, mode="mirror")

    return np.stack([derivative(1) / spacing[0], derivative(0) / spacing[1]])


def evaluate(I: Array, x: Array, order: int = ORDER) -> Array:
    """Values of an image at points ``x`` = (lateral, axial), shape (2, ...), in samples.

    Points outside the image take the value of its nearest border sample.
    """
    return ndimage.map_coordinates(I, x[::-1], order=order, mode="nearest")


def warp(I: Array, u: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The image ``I(x + u(x))``, and where ``x + u(x)`` lies inside of ``I``.

    ``u`` is measured in samples of ``I``.
    """
    height, width = I.shape
    x = u + np.mgrid[:height, :width][::-1]
    inside = (x >= 0).all(0) & (x[0] <= width - 1) & (x[1] <= height - 1)
    return evaluate(I, x), inside


def resize(I: Array, shape: tuple[int, int]) -> Array:
    """Sample an image on a grid of another size with the same corners.

    Coarser grids are preceded by a Gaussian whose width follows the reduction, as
    usual in image pyramids (0.5 samples of the coarse grid less that of the fine one).
    """
    if shape == I.shape:
        return I
    factors = [(old - 1) / (new - 1) for old, new in zip(I.shape, shape, strict=True)]
    blur = [0.5 * np.sqrt(max(f**2 - 1, 0)) for f in factors]
    smooth = ndimage.gaussian_filter(I, blur, mode="mirror") if any(blur) else I
    x2, x1 = (np.arange(n) * f for n, f in zip(shape, factors, strict=True))
    return evaluate(smooth, np.stack(np.meshgrid(x1, x2)))


def resize_field(u: Array, shape: tuple[int, int]) -> Array:
    """Sample both components of a field on another grid; its unit stays the same."""
    return np.stack([resize(c, shape) for c in u])
