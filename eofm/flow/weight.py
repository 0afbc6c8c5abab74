"""The weight of the bending energy, chosen by the images alone.

Blocks of pixels are held out, and the field that the other pixels give has to carry the
second image onto the first in those blocks. That needs neither the noise level nor the
truth, and works for few bubbles on black, where most residuals come from the model, as
for dense speckle, where they are noise.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from eofm.flow.functional import Pointwise, Quadratic, unit
from eofm.flow.matching import BLOCK, Match, held_out
from eofm.flow.multigrid import multigrid
from eofm.grid import Array, Grid, Mask
from eofm.settings import ALPHA

# Samples over which the first weight smooths.
REACH = 8.0
# Ratio of two weights that are compared: the minimum is flat; and how far they go from the
# first, in such steps.
STEP, FARTHEST = 3.0, 6
# Fewer blocks than these do not tell weights apart.
BLOCKS = 20
# Pixels around a held-out block that are not used either: the noise of images that were
# filtered is correlated, and would be fitted on both sides of the border.
MARGIN = 2
# Side of the windows that stand for a large image, or a volume, and for one larger than what, px.
WINDOW = {2: (192, 384), 3: (64, 96)}
# Change of v by the last iteration of a trial solve, px.
ACCURACY = 1e-2
# Part of the image's mean data term that is added to all: a window may be black.
RIDGE = 1e-9


def first_alpha(match: Match) -> float:
    """Weight of the coarse scales, and the first one tried.

    It holds a structure of the ``REACH`` as firmly as the mean gradient of the images does.
    """
    reach = REACH * match.grid.side
    return (match.strength + np.finfo(float).tiny) * reach**4


def combined(chosen: Sequence[float]) -> float | None:
    """Weight for which scales ask that have chosen some, from coarse to fine; None without any.

    That of the finest is taken or, where another is larger, their geometric mean: residuals that
    are correlated, as those of decorrelated speckle are, make cross-validation choose too
    little smoothing (Opsomer, Wang and Yang, Stat. Sci. 16, 2001), least so on coarser scales.
    """
    return float(np.sqrt(chosen[-1] * max(chosen))) if chosen else None


def enough(shape: tuple[int, ...]) -> bool:
    """Whether an image has blocks enough to choose a weight."""
    return math.prod(shape) >= BLOCKS * BLOCK ** len(shape)


def choose_alpha(
    match: Match,
    about: Array,
    prescribed: Array,
    free: NDArray[np.bool_],
    start: float,
) -> float:
    """Weight of the bending energy with the least misfit on held-out blocks.

    Goes downhill from ``start`` in factors of 3, then to the vertex of the parabola through
    the three best in log alpha: four or five solves for each of two quarters that are held
    out. Of large images, one quarter of some windows does, so that this takes the same time
    for all.

    Parameters
    ----------
    match : Match
    about, prescribed : ndarray, shape (ndim, ...)
        The displacement is ``about + v``, with ``v`` that of ``prescribed`` where not free.
    free : ndarray of bool
    start : float
        First weight tried.
    """
    windows = sample_windows(match.grid.shape)
    ridge = RIDGE * match.strength
    trials = [
        Trial(_cut(match, w), about[:, *w], prescribed[:, *w], free[w], fold, ridge)
        for w in windows
        for fold in ((0, 2) if len(windows) == 1 else (0,))
    ]
    return least_misfit(trials, start)


def least_misfit(trials: "Sequence[Trial]", start: float) -> float:
    """The weight with the least sum of the misfits of some trials."""
    misfits: dict[int, float] = {}

    def misfit(k: int) -> float:
        if k not in misfits:
            near = abs(k) <= FARTHEST
            misfits[k] = sum(t.misfit(start * STEP**k) for t in trials) if near else np.inf
        return misfits[k]

    k = 0
    while (better := min((k - 1, k + 1), key=misfit)) and misfit(better) < misfit(k):
        k = better
    left, middle, right = (misfit(j) for j in (k - 1, k, k + 1))
    curvature = left - 2 * middle + right
    shift = 0.5 * (left - right) / curvature if 0 < curvature < np.inf else 0.0
    return float(np.clip(start * STEP ** (k + shift), *ALPHA))


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
    ) -> None:
        self.match, self.about, self.free = match, about, free
        out = held_out(match.grid.shape, fold)
        self.out = out & match.used
        terms = match.density(about, ~around(out, MARGIN))
        self.terms = Pointwise(terms.A + ridge * unit(terms.b), terms.b)
        self.prescribed, self.v = prescribed, np.zeros_like(about)

    def misfit(self, alpha: float) -> float:
        """Sum of the squared residual on the pixels that are held out."""
        F = Quadratic(self.match.grid, self.terms, alpha, self.free, "bending")
        self.v = multigrid(F.shifted(self.prescribed), change=ACCURACY, initial=self.v)
        r = self.match.residual(self.about + self.prescribed + self.v)
        return float(np.sum(r[self.out] ** 2))


def around(mask: Mask, margin: int) -> Mask:
    """Pixels of a mask and those no farther than a margin along each axis."""
    near = mask
    for axis in range(mask.ndim):
        sides = [(margin, margin) if k == axis else (0, 0) for k in range(mask.ndim)]
        near = np.any(sliding_window_view(np.pad(near, sides), 2 * margin + 1, axis), axis=-1)
    return near


def sample_windows(shape: tuple[int, ...]) -> list[tuple[slice, ...]]:
    """The image or, where it is large, windows in the middles of opposite quarters or halves."""
    width, large = WINDOW[len(shape)]

    def cuts(n: int) -> list[slice]:
        if n <= large:
            return [slice(0, n)]
        starts = (int(np.clip(c - width // 2, 0, n - width)) for c in (n // 4, 3 * n // 4))
        return [slice(start, start + width) for start in starts]

    sides = [cuts(n) for n in shape]
    count = max(map(len, sides))
    return [tuple(side[k % len(side)] for side in sides) for k in range(count)]


def _cut(match: Match, window: tuple[slice, ...]) -> Match:
    grid = Grid(tuple(s.stop - s.start for s in window), match.grid.spacing)
    return Match(
        grid, match.u[:, *window], match.g[:, *window], match.r[window], match.used[window]
    )
