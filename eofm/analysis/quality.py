"""How far an estimate may be trusted, without knowing the truth."""

import numpy as np
from numpy.typing import NDArray

from eofm.grid import Array, inside
from eofm.imaging.gaussian import blur
from eofm.imaging.intensity import normalise
from eofm.imaging.splines import gradient, warp, warp_field


def residual(I1: Array, I2: Array, u: Array) -> Array:
    """``I2(x + u(x)) - I1(x)`` with both images in [0, 1]; NaN where x + u leaves the image."""
    I1, I2 = normalise(I1, I2)
    warped, seen = warp(I2, u)
    return np.where(seen, warped - I1, np.nan)


def inconsistency(forward: Array, backward: Array) -> Array:
    """Length of ``u(x) + w(x + u(x))``, px, for the displacements u there and w back.

    NaN where x + u leaves the image. Zero for an exact pair of fields.
    """
    height, width = forward.shape[1:]
    seen = inside((height, width), np.mgrid[:height, :width][::-1] + forward)
    return np.where(seen, np.hypot(*(forward + warp_field(backward, forward))), np.nan)


def data_share(
    I1: Array,
    smoothness: str,
    alpha: float,
    width: float,
    spacing: tuple[float, ...],
    dead: NDArray[np.bool_],
) -> Array:
    """Share of the data in the weaker direction of the estimate, from 0 to 1.

    ``l / (l + k)``, where l is the smaller eigenvalue of the mean of ``grad I grad I^T`` over a
    Gaussian of standard deviation ``width``, and k is what the smoothness term holds a bump
    of that width with: ``alpha / width^2``, or ``2 alpha / width^4`` of the bending energy.
    Near 1 the images decide, near 0 the regulariser and what is known of edges, bubbles and
    background.
    """
    g1, g2 = np.where(dead, 0, gradient(I1, spacing))
    window = width / spacing[0], width / spacing[1]
    A11, A12, A22 = (blur(A, window) for A in (g1 * g1, g1 * g2, g2 * g2))
    smaller = (A11 + A22) / 2 - np.hypot((A11 - A22) / 2, A12)
    smaller = np.maximum(smaller, 0)
    held = alpha / width**2 if smoothness == "gradient" else 2 * alpha / width**4
    return smaller / (smaller + held)
