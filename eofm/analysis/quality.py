"""How far an estimate may be trusted, without knowing the truth."""

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np

from eofm.grid import Array, Mask, precision
from eofm.imaging.gaussian import blur
from eofm.imaging.intensity import normalise
from eofm.imaging.splines import Spline, gradient, warp


def residual(I1: Array, I2: Array, u: Array) -> Array:
    """``I2(x + u(x)) - I1(x)`` with both images in [0, 1]; NaN where x + u leaves the image."""
    I1, I2 = normalise(I1, I2)
    warped, seen = warp(I2, u)
    return np.where(seen, warped - I1, np.nan)


def inconsistency(forward: Array, backward: Array) -> Array:
    """Length of ``u(x) + w(x + u(x))``, px, for the displacements u there and w back.

    NaN where x + u leaves the image. Zero for an exact pair of fields.
    """
    length = np.zeros(forward.shape[1:], precision(len(forward)))
    for there, back in zip(forward, backward, strict=True):
        warped, seen = Spline(back, odd=True).warp(forward)
        warped += there
        np.hypot(length, warped, out=length)
    return np.where(seen, length, np.nan)


def data_share(
    I1: Array,
    smoothness: str,
    alpha: float | Array,
    width: float,
    spacing: Sequence[float],
    dead: Mask,
) -> Array:
    """Share of the data in the weakest direction of the estimate, from 0 to 1.

    ``l / (l + k)``, where l is the smallest eigenvalue of the mean of ``grad I grad I^T`` over a
    Gaussian of standard deviation ``width``, and k is what the smoothness term holds a bump
    of that width with: in n dimensions ``n alpha / (2 width^2)``, or
    ``n (n + 2) alpha / (4 width^4)`` of the bending energy. Near 1 the images decide, near 0 the
    regulariser and what is known of edges, bubbles and background.
    """
    n = I1.ndim
    window = [width / h for h in spacing]
    g = np.where(dead, 0, gradient(I1, spacing))
    A = np.empty((n * (n + 1) // 2, *I1.shape), precision(n))
    for product, (i, j) in zip(A, combinations_with_replacement(range(n), 2), strict=True):
        product[...] = blur(g[i] * g[j], window)
    del g
    stiffness = n / 2 / width**2 if smoothness == "gradient" else n * (n + 2) / 4 / width**4
    held = np.broadcast_to(stiffness * alpha, I1.shape)
    share: Array = A[0]
    smallest = _smaller if n == 2 else _smallest
    for k in range(len(share)):
        least = np.maximum(smallest(*A[:, k].astype(np.float64)), 0)
        share[k] = least / (least + held[k])
    return share.copy()


def _smaller(A11: Array, A12: Array, A22: Array) -> Array:
    """Smaller eigenvalues of symmetric matrices."""
    return (A11 + A22) / 2 - np.hypot((A11 - A22) / 2, A12)


def _smallest(A11: Array, A12: Array, A13: Array, A22: Array, A23: Array, A33: Array) -> Array:
    """Smallest eigenvalues of symmetric 3 x 3 matrices, in closed form (Smith, 1961)."""
    mean = (A11 + A22 + A33) / 3
    a, b, c = A11 - mean, A22 - mean, A33 - mean
    spread = (a * a + b * b + c * c + 2 * (A12 * A12 + A13 * A13 + A23 * A23)) / 6
    det = a * (b * c - A23 * A23) - A12 * (A12 * c - A23 * A13) + A13 * (A12 * A23 - b * A13)
    size = np.sqrt(spread)
    cosine = np.divide(det, 2 * size**3, out=np.zeros_like(det), where=size > 0)
    return mean + 2 * size * np.cos((np.arccos(np.clip(cosine, -1, 1)) + 2 * np.pi) / 3)
