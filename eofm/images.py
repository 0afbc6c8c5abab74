"""Images as functions: normalise, resize, differentiate and evaluate them.

Images are float64 arrays of shape (height, width). Fields have shape (2, height,
width): component 0 is lateral (along columns), component 1 axial (along rows, down).
An image covers ``[0, width - 1] x [0, height - 1]``, its samples being the nodes of a
grid, so that a coarser image of the same sample has the same corners.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from eofm.errors import InputError

Array = NDArray[np.float64]

# Cubic splines: linear interpolation is 8 times less accurate on speckle.
ORDER = 3


def normalise(
    I1: Array, I2: Array, limits: tuple[float, float] | None = None
) -> tuple[Array, Array]:
    """Map two images to [0, 1] by one affine map, so that brightness stays comparable.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width)
        Images before and after compression.
    limits : (low, high), optional
        Intensities that become 0 and 1; by default the extremes of both images.

    Raises
    ------
    InputError
        If these are not two finite greyscale images of one size, or one is constant.
    """
    # Integers would wrap around in the differences below.
    I1, I2 = np.asarray(I1, dtype=np.float64), np.asarray(I2, dtype=np.float64)
    if I1.ndim != 2 or I1.shape != I2.shape:
        raise InputError(
            f"wanted two greyscale images of one size, got shapes {I1.shape} and {I2.shape}"
        )
    if not (np.isfinite(I1).all() and np.isfinite(I2).all()):
        raise InputError("an image has NaN or infinite values; replace or crop them")
    for name, I in (("before", I1), ("after", I2)):
        if I.min() == I.max():
            raise InputError(
                f"the image {name} compression is constant ({I.min():g}): there is no motion"
                " to see; check that the right file was given"
            )
    low, high = limits or (min(I1.min(), I2.min()), max(I1.max(), I2.max()))
    return (I1 - low) / (high - low), (I2 - low) / (high - low)


def normalise_locally(I: Array, window: tuple[float, float]) -> Array:
    """Remove the local mean of an image and divide by its local contrast.

    For pairs whose brightness changes from place to place. Means are Gaussian averages of
    standard deviations ``window`` = (lateral, axial), in samples. Three local standard
    deviations fill half of [0, 1], and contrast is not raised where there is a tenth of
    the image's or less.
    """

    def mean(J: Array) -> Array:
        return ndimage.gaussian_filter(J, window[::-1], mode="mirror")

    deviation = I - mean(I)
    contrast = np.sqrt(mean(deviation**2) + (0.1 * I.std()) ** 2)
    return 0.5 + deviation / (6 * contrast)


def gradient(I: Array, spacing: tuple[float, float] = (1.0, 1.0)) -> Array:
    """Gradient of the cubic spline through an image, shape (2, height, width).

    ``spacing`` holds the lateral and the axial distance of the samples.
    """

    def derivative(axis: int) -> Array:
        c = ndimage.spline_filter1d(I, ORDER, axis, mode="mirror")
        return ndimage.correlate1d(c, [-0.5, 0, 0.5], axis, mode="mirror")

    return np.stack([derivative(1) / spacing[0], derivative(0) / spacing[1]])


def evaluate(I: Array, x: Array) -> Array:
    """Values of an image at points ``x`` = (lateral, axial), shape (2, ...), in samples.

    Points outside the image take the value of its nearest border sample.
    """
    return ndimage.map_coordinates(I, x[::-1], order=ORDER, mode="nearest")


def evaluate_field(u: Array, x: Array) -> Array:
    """Both components of a field at points, shape (2, ...)."""
    return np.stack([evaluate(c, x) for c in u])


def inside(shape: tuple[int, int], x: Array) -> NDArray[np.bool_]:
    """Where points, shape (2, ...), lie in an image of a shape (height, width)."""
    height, width = shape
    return (x[0] >= 0) & (x[0] <= width - 1) & (x[1] >= 0) & (x[1] <= height - 1)


def warp(I: Array, u: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The image ``I(x + u(x))``, and where ``x + u(x)`` lies inside of ``I``.

    ``u`` is measured in samples of ``I``.
    """
    height, width = I.shape
    x = u + np.mgrid[:height, :width][::-1]
    return evaluate(I, x), inside(I.shape, x)


def warp_field(f: Array, u: Array) -> Array:
    """Both components of ``f(x + u(x))``, shape (2, height, width)."""
    return np.stack([warp(c, u)[0] for c in f])


def unit_spacing(pixel_size: tuple[float, float]) -> tuple[float, float]:
    """Lateral and axial side of a pixel in the unit that gives it the area 1."""
    side = np.sqrt(np.prod(pixel_size))
    return float(pixel_size[0] / side), float(pixel_size[1] / side)


def resize(I: Array, shape: tuple[int, int]) -> Array:
    """Sample an image on a grid of another size with the same corners.

    A coarser grid is preceded by a Gaussian that takes the blur of a pixel from 0.5
    samples of the fine grid to 0.5 of the coarse one.
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


def gaussians(x1: Array, x2: Array, centres: Array, sigma: ArrayLike, weights: Array) -> Array:
    """Weighted sums of Gaussians of height 1, cut off at 6 sigma.

    Parameters
    ----------
    x1, x2 : ndarray, shape (width,) and (height,)
        Ascending lateral and axial positions of the samples.
    centres : ndarray, shape (2, M)
    sigma : float or ndarray, shape (M,)
        Standard deviations.
    weights : ndarray, shape (k, M)
        The weights of k sums over the same Gaussians.

    Returns
    -------
    ndarray, shape (k, height, width)
    """
    total = np.zeros((len(weights), len(x2), len(x1)))
    widths = np.broadcast_to(sigma, centres.shape[1:])
    for (c1, c2), s, w in zip(centres.T, widths, weights.T, strict=True):
        columns = slice(*np.searchsorted(x1, [c1 - 6 * s, c1 + 6 * s]))
        rows = slice(*np.searchsorted(x2, [c2 - 6 * s, c2 + 6 * s]))
        g1 = np.exp(-((x1[columns] - c1) ** 2) / (2 * s**2))
        g2 = np.exp(-((x2[rows] - c2) ** 2) / (2 * s**2))
        total[:, rows, columns] += w[:, None, None] * np.outer(g2, g1)
    return total
