"""What a weight of the bending energy is tried on: blocks of pixels that are held out."""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from eofm.flow.functional import ORDERS, Pointwise, Quadratic, unit
from eofm.flow.hierarchy import CoarseTerms, hierarchy
from eofm.flow.matching import BLOCK, Match, held_out
from eofm.flow.multigrid import multigrid
from eofm.grid import Array, Mask

# Fewer blocks than these do not tell weights apart well; the finest scale, whose weight nothing
# else tells, makes do with FEWEST. Where there are fewer than MANY, all are held out by turns, and
# one quarter alone from PLENTY on; a block of a volume holds eight times as much.
BLOCKS, FEWEST, MANY, PLENTY = 20, 8, {2: 256, 3: 64}, {2: math.inf, 3: 256}
# Side of blocks, and the pixels around them that are not used either.
Blocks = tuple[int, int]
# Weight of volumes, times the first one, above which rounding in single precision outweighs the
# images. The motion is as good as affine there.
STIFFEST = 27.0
# Samples over which the first weight smooths.
REACH = 8.0
# Change of v by the last iteration of a trial solve, px; trials are most of the time of a volume.
ACCURACY = {2: 1e-2, 3: 3e-2}
# Part of the image's mean data term that is added to all: a window may be black.
RIDGE = 1e-9
TINY = float(np.finfo(np.float32).tiny)


def first_alpha(match: Match) -> float:
    """Weight of the coarse scales, and the first one tried.

    It holds a structure of the ``REACH`` as firmly as the mean gradient of the images does.
    """
    return (match.strength + np.finfo(float).tiny) * (REACH * match.grid.side) ** 4


def reach(match: Match, alpha: float, smoothness: str = "bending") -> float:
    """Samples over which a weight smooths: those of `first_alpha` are REACH."""
    power = 1 / (2 * ORDERS[smoothness])
    return float((alpha / (match.strength + TINY)) ** power / match.grid.side)


def enough(shape: tuple[int, ...], finest: bool) -> bool:
    """Whether a scale has blocks enough to choose a weight."""
    return math.prod(shape) >= (FEWEST if finest else BLOCKS) * BLOCK ** len(shape)


def folds(shape: tuple[int, ...], windows: int) -> tuple[int, ...]:
    """Quarters that are held out by turns."""
    ndim = len(shape)
    blocks = math.prod(shape) / BLOCK**ndim
    if blocks < MANY[ndim]:
        return 0, 1, 2, 3
    return (0, 2) if windows == 1 and blocks < PLENTY[ndim] else (0,)


class Trial:
    """One fold of one window; each solve starts from the one before."""

    def __init__(
        self,
        match: Match,
        about: Array,
        prescribed: Array,
        free: NDArray[np.bool_],
        fold: int,
        ridge: float,
        counts: Array,
        blocks: Blocks,
    ) -> None:
        self.match, self.about, self.free = match, about, free
        (side, margin), shape = blocks, match.grid.shape
        out = held_out(shape, fold, side)
        self.counts = counts * (out & match.used)
        terms = match.density(about, ~around(out, margin))
        self.terms = Pointwise(terms.A + ridge * unit(terms.b), terms.b)
        self.prescribed, self.v, self.known = prescribed, np.zeros_like(about), CoarseTerms()
        single = terms.A.dtype == np.float32
        self.most = STIFFEST * first_alpha(match) if single else math.inf

    def misfit(self, alpha: float) -> float:
        """Sum of the squared residual on the pixels that are held out, as often as each counts."""
        alpha = min(alpha, self.most)
        F = Quadratic(self.match.grid, self.terms, alpha, self.free, "bending")
        F = F.shifted(self.prescribed)
        levels = hierarchy(F, self.known)
        self.v = multigrid(F, change=ACCURACY[len(self.v)], initial=self.v, levels=levels)
        r = self.match.residual(self.about + self.prescribed + self.v)
        return float(np.sum(self.counts * r**2))


def around(mask: Mask, margin: int) -> Mask:
    """Pixels of a mask and those no farther than a margin along each axis."""
    near = mask
    for axis in range(mask.ndim):
        sides = [(margin, margin) if k == axis else (0, 0) for k in range(mask.ndim)]
        near = np.any(sliding_window_view(np.pad(near, sides), 2 * margin + 1, axis), axis=-1)
    return near
