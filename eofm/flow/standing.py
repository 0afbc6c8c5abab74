"""What stands still in both images while the sample moves: dirt, a mesh, noise that comes back.

Where it is not told from the sample, it pulls the displacement towards zero, and nothing that is
left of the images shows it: what stands agrees a little less, and the sample too. But the two have
seldom structures of the same width. So structures of each width are asked how much farther along
the displacement they have moved: where it is right, none has, whatever the noise.
"""

from typing import NamedTuple

import numpy as np

from eofm.flow.likeness import difference
from eofm.grid import Array, Mask
from eofm.imaging.gaussian import blur
from eofm.imaging.splines import gradient

# Widths, px, between which structures are fine, of medium width, and coarse.
WIDTHS = (0.0, 2.0), (2.0, 4.0), (4.0, 8.0)
# Parts of each side of the image whose answers tell the error, and how many have to be there.
PARTS, FEWEST = {2: 4, 3: 3}, 6
# Displacement below which it has no direction, px.
STILL = 0.1
# How many errors tell that structures have moved farther; and by how much they have, px, where
# finer ones stand.
SURE, ENOUGH = 4.0, 0.02
# How much farther fine ones have where coarse ones stand, and how many errors and px tell that
# these are left behind: they pull a little, and disagree by far.
FAINTLY, BEHIND = 0.01, (3.0, 0.05)
# The part of it that is left at most where another way is the better one.
LESS = 0.75
# Ways to leave out what stands: fine structures by a Gaussian, coarse ones by the mean around.
WITHOUT_FINE, WITHOUT_COARSE = {"denoising": 2.0}, {"local_window": 4.0}
TINY = float(np.finfo(np.float32).tiny)


class Farther(NamedTuple):
    """How much farther some structures have moved than a displacement says, px."""

    by: float = 0.0
    error: float = np.inf

    def surely(self, least: float, errors: float) -> bool:
        """Whether it is more than that, and than so many errors."""
        return self.by > max(least, errors * self.error)


class Standing(NamedTuple):
    """How much farther structures of each width have moved than a displacement says."""

    fine: Farther
    medium: Farther
    coarse: Farther

    @property
    def pull(self) -> float:
        """How much farther some have surely moved, px."""
        told = (f.by for f in (self.fine, self.medium) if f.surely(0, SURE))
        return max(told, default=0.0)

    def pulls_less(self, before: "Standing") -> bool:
        """Whether another way to estimate was clearly better."""
        return self.pull < LESS * before.pull

    @property
    def way_out(self) -> dict[str, float]:
        """What a setting has to be that structures which stand may not count; empty if none do."""
        if self.medium.surely(ENOUGH, SURE) and self.fine.by < 0:
            return WITHOUT_FINE
        errors, least = BEHIND
        behind = self.coarse._replace(by=-self.coarse.by).surely(least, errors)
        if behind and self.fine.surely(FAINTLY, SURE):
            return WITHOUT_COARSE
        return {}


def standing(I1: Array, warped: Array, used: Mask, u: Array) -> Standing:
    """How much farther along a displacement structures of each width have moved.

    A regression of what is left on the derivative along it, which is the mean of both images, so
    that noise has no mean in it. The error is that of the parts of the image among each other.

    Parameters
    ----------
    I1, warped : ndarray, shape (height, width) or (depth, height, width)
        The image before compression, and the one after it at ``x + u(x)``.
    used : ndarray of bool, of that shape
        Pixels that carry data.
    u : ndarray, shape (2, ...) or (3, ...)
        In px.
    """
    if not used.any():
        return Standing(Farther(), Farther(), Farther())
    # Of brightness and contrast only what is alike everywhere is taken off.
    change = np.zeros_like(I1)
    change[used] = -difference(I1[used], warped[used])[0]
    mean = I1 + change / 2
    length = np.maximum(np.sqrt((u**2).sum(0)), STILL)
    found = []
    for low, high in WIDTHS:
        band, left = (_between(f, low, high) for f in (mean, change))
        along = (gradient(band) * u).sum(0) / length
        found.append(_farther(along, left, used, int(2 * high) + 2))
    return Standing(*found)


def _between(f: Array, low: float, high: float) -> Array:
    """What a Gaussian of one width leaves and one of another does not."""
    return (blur(f, low) if low else f) - blur(f, high)


def _farther(along: Array, left: Array, used: Mask, margin: int) -> Farther:
    """Regression of what is left on the derivative, but for a margin that filters reach into."""
    if min(used.shape) <= 2 * margin:
        return Farther()
    inner = (slice(margin, -margin),) * used.ndim
    along, left, used = along[inner], left[inner], used[inner]
    parts = PARTS[used.ndim]
    number = np.zeros(used.shape, dtype=np.intp)
    for axis, n in enumerate(used.shape):
        at = np.arange(n) * parts // n
        number = number * parts + at.reshape([-1 if k == axis else 1 for k in range(used.ndim)])
    product, square = (
        np.bincount(number[used], f[used], parts**used.ndim) for f in (along * left, along**2)
    )
    count, total = int(np.count_nonzero(square > TINY)), float(square.sum())
    if count < FEWEST:
        return Farther()
    by = -float(product.sum()) / total
    rest = float(np.sqrt(((product + by * square) ** 2).sum()) / total)
    return Farther(by, rest * float(np.sqrt(count / (count - 1))))
