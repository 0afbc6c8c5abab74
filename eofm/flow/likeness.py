"""How much of one image another one shows after a displacement, and where it does not."""

import numpy as np

from eofm.grid import Array, Grid, Mask
from eofm.imaging.gaussian import blur
from eofm.imaging.intensity import Window
from eofm.imaging.splines import Spline

# Width over which images are correlated, samples.
WIDTH = 4.0
# Width over which parts of images are compared, samples, the least variance of one as a part of
# the mean, and the largest part of an image that may be unlike the other one.
PATCH, FLAT, DETAIL, MOST = 3.0, 0.01, 2.0, 0.35
# How much less than 1 their correlation is where they are likely, and certain, to show different
# things: at least, and as a multiple of the median.
UNLIKE, UNUSUAL = (0.2, 0.4), (4.0, 8.0)
# How much less than 1 that is at most where they are sure to show the same.
SURE = 0.3
TINY = 1e-12


def correlation(I1: Array, I2: Array, u: Array, grid: Grid) -> float:
    """Mean of the local correlation of two images after a displacement; 0 where it leaves them."""
    # Out of the image by rounding is not out of it: of small images, the outer pixels are many.
    local, seen = _correlation(I1, I2, np.round(grid.samples(u), 3), WIDTH)
    return float((local * seen).mean())


def unlike(I1: Array, I2: Array, u: Array, grid: Grid, live: Mask) -> Mask | None:
    """Where images do not correlate after a displacement, though nearly all of them does.

    Something lies on one of the two, or is gone: its outlines would pull the field to wherever
    they find a place. Around where that is certain, all is left out where it is likely, and what
    is enclosed. Shadows have no sharp outlines: only fine structures are compared. None if there
    is no such part, or it is so large that it may be the motion that was not found.
    """
    from scipy import ndimage

    miss, seen, (likely, certain) = _missed(I1, I2, u, grid, live)
    label, _ = ndimage.label(seen & (miss > likely))
    sure = np.unique(label[miss > certain])
    found = ndimage.binary_fill_holes(np.isin(label, sure[sure > 0]))
    return found if 0 < np.count_nonzero(found) <= MOST * found.size else None


def alike(I1: Array, I2: Array, u: Array, grid: Grid, live: Mask) -> Mask:
    """Where fine structures correlate after a displacement as they usually do."""
    miss, seen, (likely, _) = _missed(I1, I2, u, grid, live)
    return seen & (miss <= min(likely, SURE))


def details(I1: Array, I2: Array, u: Array, grid: Grid, live: Mask) -> float:
    """Mean correlation of fine structures after a displacement, whatever the brightness does."""
    local, seen = _details(I1, I2, u, grid, live)
    return float(local.mean(where=seen)) if seen.any() else 0.0


def left(I1: Array, I2: Array, dead: Mask, u: Array) -> tuple[Array, Mask, float]:
    """What a displacement, px, leaves of I1, but for a gain and an offset; where; and the gain."""
    warped, used = Spline(I2).warp(u)
    used &= ~dead
    if not used.any():
        return np.zeros(0), used, 1.0
    rest, gain = difference(I1[used], warped[used])
    return rest, used, gain


def ratio_left(I1: Array, I2: Array, dead: Mask, u: Array, other: Array) -> float:
    """Variance that another displacement, px, leaves as a part of that which ``u`` leaves.

    Where both stay within the image. If that is less than half of it, it is 0 or infinite, as the
    other one does or not.
    """
    after = Spline(I2)
    (first, seen), (second, there) = (after.warp(v) for v in (u, other))
    there &= ~dead
    both, enough = seen & there, np.count_nonzero(~dead) / 2
    if np.count_nonzero(both) < enough:
        return np.inf if np.count_nonzero(there) < enough else 0.0
    much, less = (difference(I1[both], warped[both])[0].var() for warped in (first, second))
    return float(less / (much + TINY))


def difference(before: Array, after: Array) -> tuple[Array, float]:
    """What is left of values, but for a gain and an offset, and the gain."""
    gain = float(before.std() / (after.std() + TINY))
    rest = before - gain * after
    return rest - rest.mean(), gain


def _missed(
    I1: Array, I2: Array, u: Array, grid: Grid, live: Mask
) -> tuple[Array, Mask, tuple[float, float]]:
    """How much less than 1 the correlation of details is, where, and what is much of that."""
    local, seen = _details(I1, I2, u, grid, live)
    miss = 1 - local
    usual = float(np.median(miss[seen])) if seen.any() else np.inf
    return miss, seen, (max(UNLIKE[0], UNUSUAL[0] * usual), max(UNLIKE[1], UNUSUAL[1] * usual))


def _details(I1: Array, I2: Array, u: Array, grid: Grid, live: Mask) -> tuple[Array, Mask]:
    I1, I2 = (I - blur(I, (DETAIL,) * I.ndim) for I in (I1, I2))
    local, seen = _correlation(I1, I2, grid.samples(u), PATCH)
    return local, seen & live


def _correlation(I1: Array, I2: Array, samples: Array, width: float) -> tuple[Array, Mask]:
    """Local correlation of two images after a displacement, and where it stays within them."""
    warped, seen = Spline(I2).warp(samples)
    around = Window(seen, width)
    m1, m2 = around.mean(I1), around.mean(warped)
    v1, v2 = around.mean(I1**2) - m1**2, around.mean(warped**2) - m2**2
    # What is black, or flat, is like nothing.
    v1, v2 = (np.maximum(v, FLAT * np.mean(v, where=seen) + TINY) for v in (v1, v2))
    return (around.mean(I1 * warped) - m1 * m2) / np.sqrt(v1 * v2), seen
