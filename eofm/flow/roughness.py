"""Where motion is rough and where it is smooth: a regulariser that adapts.

One weight for an image follows noise where motion is smooth, or flattens a shear band or the edge
of an inclusion. The weight at a place is therefore taken in inverse proportion to how rough the
field is there that the solve before has found. With that repeated from scale to scale, what is
minimised is close to a robust penalty, the logarithm of the squared second derivatives
(half-quadratic: Geman and Reynolds, IEEE Trans. Pattern Anal. Mach. Intell. 14, 1992).
"""

import numpy as np

from eofm.grid import Array, Grid
from eofm.imaging.gaussian import blur

# Width over which roughness is averaged, samples; least roughness, 1/px; largest ratio of two
# weights.
WIDTH, LEAST, LARGEST = 8.0, 1e-6, 1e3
# Noise in a field is as rough as motion, but within what a weight smooths over: a Gaussian that is
# so many times as wide, and so wide at most, samples, takes it away.
SMOOTHED, WIDEST = 2.0, 8.0


def ease(v: Array, grid: Grid, seen: Array, reach: float) -> Array:
    """How much less than elsewhere a field is to be smoothed at each pixel, of the grid's shape.

    All terms but R are multiplied by it, which is as if R were divided by it, but for
    derivatives of its logarithm, and leaves the solver a constant weight.

    Parameters
    ----------
    v : ndarray, shape (2, height, width)
        What R acts on, true lengths.
    grid : Grid
    seen : ndarray, of the grid's shape
        Squared gradient of the images, 0 where there are no data.
    reach : float
        Samples over which the weight has smoothed v.

    Returns
    -------
    ndarray
        Its mean is 1 where motion is rough, weighed by what roughness the images show.
    """
    rough = blur(squared_bending(v, grid, min(SMOOTHED * reach, WIDEST)), WIDTH)
    base = np.median(rough) + LEAST**2  # what noise is left is rough as well
    factor = np.minimum(base + rough, LARGEST * (base + rough.min()))
    shown = rough * seen
    total = shown.sum()
    return factor * (total / (factor * shown).sum()) if total > 0 else np.ones_like(factor)


def squared_bending(v: Array, grid: Grid, width: float) -> Array:
    """``sum_ij |d_ij v|^2`` of a Gaussian average at each pixel, by central differences.

    Derivatives are averaged, for those of affine motions are 0 at the edges as well.
    """
    total = np.zeros_like(v[0])
    axes = range(grid.ndim)
    for f in v:
        for i in axes:
            first = np.gradient(f, grid.spacing[grid.ndim - 1 - i], axis=i)
            for j in axes[i:]:
                second = np.gradient(first, grid.spacing[grid.ndim - 1 - j], axis=j)
                total += (1 if i == j else 2) * blur(second, width) ** 2
    return total
