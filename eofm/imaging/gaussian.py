"""Averages under Gaussians, and sums of them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eofm.grid import Array, precision
from eofm.imaging.sums import Bumps, Terms, add_gaussians, resample


def blur(I: Array, width: ArrayLike) -> Array:
    """Gaussian average of an image or a volume that goes on as in a mirror.

    Parameters
    ----------
    I : ndarray, shape (height, width) or (depth, height, width)
    width : float or (lateral, axial, ...)
        Standard deviation, samples.
    """
    terms = []
    for n, std in zip(I.shape, np.broadcast_to(width, I.ndim)[::-1], strict=True):
        offsets, gauss = taps(std)
        at, _ = mirrored(np.arange(n)[:, None] + offsets, n)
        terms.append(Terms(at, np.tile(gauss, (n, 1))))
    J = np.empty(I.shape, precision(I.ndim))
    resample(J, np.require(I, J.dtype, ["C", "W"]), terms)
    return J


def gaussians(axes: Sequence[Array], centres: Array, sigma: ArrayLike, weights: Array) -> Array:
    """Weighted sums of Gaussians of height 1, cut off at 6 sigma.

    Parameters
    ----------
    axes : sequence of ndarray, shape (width,), (height,), ...
        Ascending lateral, axial, ... positions of the samples.
    centres : ndarray, shape (ndim, M)
    sigma : float or ndarray, shape (M,)
        Standard deviations.
    weights : ndarray, shape (k, M)
        The weights of k sums over the same Gaussians.

    Returns
    -------
    ndarray, shape (k, height, width) or (k, depth, height, width)
    """
    total = np.zeros((len(weights), *(len(x) for x in axes[::-1])), precision(len(axes)))
    sigma = np.array(np.broadcast_to(sigma, centres.shape[1:]), dtype=np.float64)
    spans = np.stack(
        [
            np.searchsorted(x, [c - 6 * sigma, c + 6 * sigma])
            for x, c in zip(axes, centres, strict=True)
        ]
    )
    *axes, centres, weights = (
        np.require(a, np.float64, ["C", "W"]) for a in (*axes, centres, weights)
    )
    add_gaussians(total, tuple(axes), Bumps(centres, sigma, spans), weights)
    return total


def taps(width: float) -> tuple[NDArray[np.intp], Array]:
    """Offsets of samples and their weights in a Gaussian average, cut off at 4 widths."""
    radius = int(4 * width + 0.5)
    offsets = np.arange(-radius, radius + 1)
    gauss = np.exp(-0.5 * (offsets / max(width, 1e-9)) ** 2)
    return offsets, gauss / gauss.sum()


def mirrored(k: NDArray[np.intp], n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The samples, of n, that stand at indices k in a mirrored image, and in which copy of it."""
    copies, at = np.divmod(k, max(n - 1, 1))
    return np.where(copies % 2, n - 1 - at, at), copies
