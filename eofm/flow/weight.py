"""The weight of the bending energy, chosen by the images alone.

Blocks of pixels are held out, and the field that the other pixels give has to carry the
second image onto the first in those blocks. That needs neither the noise level nor the
truth, and works for few bubbles on black, where most residuals come from the model, as
for dense speckle, where they are noise.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from eofm.flow.functional import Pointwise, Quadratic, unit
from eofm.flow.matching import BLOCK, Match, held_out
from eofm.flow.multigrid import CoarseTerms, hierarchy, multigrid
from eofm.grid import Array, Grid, Mask
from eofm.settings import ALPHA

# Samples over which the first weight smooths.
REACH = 8.0
# Ratio of two weights that are compared: the minimum is flat; and how far they go from the
# first, in such steps.
STEP, FARTHEST = 3.0, 6
# A misfit as large as that of a motion which is off by so many samples may be a motion that was
# lost; by how many steps less it is looked for, and the part of the misfit that tells.
LOST, PROBES, TELLS = 0.25, (2, 4, 6, 8, 10, 12), 0.9
# Part of the misfit that is left at most if a weight that varies is to be believed.
GAIN = 0.999
# By how little weights larger by so many steps change the misfit where the motion is as stiff as
# one can make it, so that nothing leads downhill.
STIFF, UP = 1e-3, (1, 4)
# Misfit, as a part of the least, up to which a weight that other scales ask for is as good.
EQUAL = 1.1
# Fewer blocks than these do not tell weights apart well; the finest scale, whose weight nothing
# else tells, makes do with FEWEST. Where there are fewer than MANY, all are held out by turns, and
# one quarter alone from PLENTY on; a block of a volume holds eight times as much.
BLOCKS, FEWEST, MANY, PLENTY = 20, 8, {2: 256, 3: 64}, {2: math.inf, 3: 256}
# Pixels around a held-out block that are not used either: the noise of images that were
# filtered is correlated, and would be fitted on both sides of the border.
MARGIN = 2
# Sides of blocks, and margins: those, and some that are short for a wavelength of 20 samples, which
# could not be told from what lies around larger ones; and how much less the weight is that those
# find where motion was lost. Where the finest scale finds one as much less than a coarser one did,
# blocks of twice the side decide if structures are as wide as a block: what is left of such that
# change is told in small blocks by what is around them, as motion is.
Blocks = tuple[int, int]
USUAL, SMALL, LARGE, FOUND = (BLOCK, MARGIN), (4, 1), (2 * BLOCK, 2 * MARGIN), STEP**4
# Structures as wide as a block: gradients half of it apart correlate more than this part of how
# those two samples apart do. Speckle 9 samples wide has 0.5 to 0.8, such of 2 none.
WIDE = 0.5
# Weight of volumes, times the first one, above which rounding in single precision outweighs the
# images. The motion is as good as affine there.
STIFFEST = 27.0
# Side of the windows that stand for a large image, or a volume, and for one larger than what, px;
# and how many there are.
WINDOW, WINDOWS = {2: (120, 384), 3: (48, 96)}, 5
# Pixels at its sides that only the field is given: a window ends where the image goes on, and the
# field is worse there than in the image, which would make weights too small.
INNER = 2 * BLOCK
# Part of the windows that goes by the data alone, not by the roughness of the motion.
EVEN = 0.5
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


def reach(match: Match, alpha: float) -> float:
    """Samples over which a weight smooths: those of `first_alpha` are REACH."""
    return float((alpha / (match.strength + TINY)) ** 0.25 / match.grid.side)


def enough(shape: tuple[int, ...], finest: bool) -> bool:
    """Whether a scale has blocks enough to choose a weight."""
    return math.prod(shape) >= (FEWEST if finest else BLOCKS) * BLOCK ** len(shape)


def choose_alpha(
    match: Match,
    about: Array,
    prescribed: Array,
    free: NDArray[np.bool_],
    start: float,
    before: Sequence[float] = (),
    ease: Array | None = None,
) -> "Choice":
    """Weight of the bending energy with the least misfit on held-out blocks, and that to use.

    Goes downhill from ``start`` in factors of 3, upwards first, then to the vertex of the
    parabola through the three best in log alpha: four or five solves for each of two quarters
    that are held out. Of large images, one quarter of some windows does, so that this takes the
    same time for all; of small ones all quarters are held out. Windows lie where motion is rough
    and where it is smooth, and count as what they stand for, see `drawn`.

    Motion that varies within a few structures of the image has two minima: large weights
    smooth it away, those between follow some of it wrongly, and small ones find it. So
    the first scale to choose looks for another one far below, where much is left unexplained,
    by smaller blocks: it does not follow from what is around larger ones. Any scale does, where
    the motion is as stiff as a weight can make it: an affine one, whose misfit is the same
    for all large weights.

    Parameters
    ----------
    match : Match
    about, prescribed : ndarray, shape (ndim, ...)
        The displacement is ``about + v``, with ``v`` that of ``prescribed`` where not free.
    free : ndarray of bool
    start : float
        First weight tried.
    before : sequence of float
        Weights that coarser scales have chosen. Residuals that are correlated, as those of
        decorrelated speckle are, make cross-validation choose too little smoothing (Opsomer,
        Wang and Yang, Stat. Sci. 16, 2001), least so on coarser scales. Where one of them is
        larger, its geometric mean with that of this scale is used, as far as the misfit allows.
    ease : ndarray, optional
        By which the weight may be divided at each pixel, see :func:`eofm.flow.roughness.ease`,
        which is done where it lessens the misfit.
    """
    windows = _windows(match)

    def trials(ease: Array | float, blocks: Blocks) -> list[Trial]:
        eased = match if isinstance(ease, float) else match.eased(ease)
        ridge = RIDGE * eased.strength
        shares = np.broadcast_to(ease, match.grid.shape)
        return [
            Trial(
                _cut(eased, w),
                about[:, *w],
                prescribed[:, *w],
                free[w],
                fold,
                ridge,
                counts / shares[w],
                blocks,
            )
            for w, counts in windows
            for fold in folds(match.grid.shape, len(windows))
        ]

    even, blocks = best_weight(partial(trials, 1.0), start, before)
    if ease is None:
        return even
    uneven = trials(ease, blocks)
    if sum(t.misfit(even.best) for t in uneven) > GAIN * even.misfit:
        return even
    return least_misfit(uneven, even.best, before or (even.best,))._replace(eased=True)


class Choice(NamedTuple):
    """The best weight by itself, that to use, the misfit, whether the weight is to vary."""

    best: float
    alpha: float
    misfit: float
    eased: bool = False


def best_weight(
    trials: "Callable[[Blocks], Sequence[Trial]]", start: float, before: Sequence[float]
) -> tuple[Choice, Blocks]:
    """The weight with the least misfit on blocks of some size, small ones where motion is lost."""
    usual = trials(USUAL)
    choice, side = least_misfit(usual, start, before), usual[0].match.grid.side
    if before and choice.best < start / FOUND and _wide([t.match.g for t in usual]):
        large = least_misfit(trials(LARGE), start, before)
        return (choice, USUAL) if large.best < start / FOUND else (large, LARGE)
    squares = sum(float((t.counts * (t.match.g**2).sum(0)).sum()) for t in usual)
    if not before and choice.misfit > (LOST * side) ** 2 * squares:
        small = least_misfit(trials(SMALL), choice.best, lost=True)
        if small.best < choice.best / FOUND:
            return small, SMALL
    return choice, USUAL


def _wide(gradients: Sequence[Array]) -> bool:
    """Whether structures are as wide as a block."""

    def alike(lag: int) -> float:
        total = 0.0
        for g in gradients:
            for axis in range(1, g.ndim):
                f = np.moveaxis(g, axis, 0)
                total += float((f[lag:] * f[:-lag]).sum())
        return total

    return alike(BLOCK // 2) > WIDE * alike(2) > 0


def least_misfit(
    trials: "Sequence[Trial]",
    start: float,
    before: Sequence[float] = (),
    lost: bool = False,
) -> Choice:
    """The weight with the least sum of the misfits of some trials, and that to use.

    Of a motion that is ``lost``, another minimum is looked for far below the first one.
    """

    @cache
    def misfit(k: int) -> float:
        return sum(t.misfit(start * STEP**k) for t in trials)

    def downhill(first: int) -> int:
        k = first
        for step in (1, -1):  # larger weights first: their solves are cheaper
            while abs(k + step - first) <= FARTHEST and misfit(k + step) < misfit(k):
                k += step
            if k != first:
                break
        return k

    k = downhill(0)
    high, low = max(k, 0), min(k, 0)
    stiff = all(misfit(high + far) < (1 + STIFF) * misfit(high) for far in UP)
    if lost or stiff:
        low = min((low - far for far in PROBES), key=misfit)
        if misfit(low) < (1 if stiff else TELLS) * misfit(k):
            k = downhill(low)
    left, middle, right = (misfit(j) for j in (k - 1, k, k + 1))
    curvature = left - 2 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature > 0 else 0.0
    largest = min(ALPHA[1], *(t.most for t in trials))
    best = float(np.clip(start * STEP ** (k + np.clip(shift, -1, 1)), ALPHA[0], largest))
    asked = min(math.sqrt(best * max(best, *before)), largest) if before else best
    most = k
    while start * STEP**most < asked and misfit(most + 1) <= EQUAL * misfit(k):
        most += 1
    return Choice(best, max(best, min(asked, start * STEP**most)), misfit(k))


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


def folds(shape: tuple[int, ...], windows: int) -> tuple[int, ...]:
    """Quarters that are held out by turns."""
    ndim = len(shape)
    blocks = math.prod(shape) / BLOCK**ndim
    if blocks < MANY[ndim]:
        return 0, 1, 2, 3
    return (0, 2) if windows == 1 and blocks < PLENTY[ndim] else (0,)


def _windows(match: Match) -> list[tuple[tuple[slice, ...], Array]]:
    """The image or, where it is large, some windows, and how often each pixel counts."""
    width, large = WINDOW[match.grid.ndim]
    shape = match.grid.shape
    if max(shape) <= large:
        return [(tuple(slice(0, n) for n in shape), np.ones(shape))]
    sides = [_tiles(n, width) for n in shape]
    data, rough = _contents(match, sides)
    windows = []
    for k, count in drawn(EVEN * data + (1 - EVEN) * rough, WINDOWS):
        window = tuple(side[i] for side, i in zip(sides, k, strict=True))
        windows.append((window, _counts(shape, window, count)))
    return windows


def _tiles(n: int, width: int) -> list[slice]:
    """Windows that cover an axis of n samples, and overlap as little as they can."""
    width = min(n, width)
    starts = np.linspace(0, n - width, -(-n // width)).round().astype(int)
    return [slice(int(start), int(start) + width) for start in starts]


def _contents(match: Match, sides: list[list[slice]]) -> tuple[Array, Array]:
    """Shares of the windows of a lattice in the squared gradient, and in that times roughness.

    Roughness is the squared second difference of the motion between blocks. What a
    weight takes away of it is seen where there are gradients.
    """
    blocks = [np.arange(0, n, BLOCK) for n in match.grid.shape]

    def blockwise(f: Array) -> Array:
        for axis, starts in enumerate(blocks):
            f = np.add.reduceat(f, starts, axis)
        return f

    data = blockwise((match.g**2).sum(0) * match.used)
    u, rough = match.u, np.zeros_like(data)
    for axis, starts in enumerate(blocks):
        u = u.take(starts, axis + 1)
    for axis, n in enumerate(data.shape):
        inner = tuple(slice(1, -1) if k == axis else slice(None) for k in range(data.ndim))
        if n > 2:
            rough[inner] += (np.diff(u, 2, axis + 1) ** 2).sum(0)
    shares = []
    for part in (data, data * rough):
        sums = np.empty([len(side) for side in sides])
        for k in np.ndindex(sums.shape):
            window = (side[i] for side, i in zip(sides, k, strict=True))
            sums[k] = part[
                tuple(slice(s.start // BLOCK, s.stop // BLOCK + 1) for s in window)
            ].sum()
        shares.append((sums + TINY) / (sums + TINY).sum())
    return shares[0], shares[1]


def drawn(share: Array, count: int) -> list[tuple[tuple[int, ...], float]]:
    """Indices of places drawn in proportion to their share, and the inverse of that probability.

    Sums over the places drawn, each times that number, are estimates of sums over all of them
    without bias (Horvitz and Thompson, J. Am. Stat. Assoc. 47, 1952). Draws are systematic: the
    middles of ``count`` equal parts of the accumulated share, with every other row backwards,
    so that neighbours do not stand for each other. A place that is met twice counts twice.

    Parameters
    ----------
    share : ndarray
        Positive, of sum 1.
    count : int
    """
    numbers = np.arange(share.size).reshape(share.shape)
    numbers[1::2] = numbers[1::2, ::-1]
    order = numbers.ravel()
    ends = np.cumsum(share.ravel()[order])
    middles = ends[-1] * (np.arange(count) + 0.5) / count
    places, times = np.unique(np.searchsorted(ends, middles), return_counts=True)
    return [
        (np.unravel_index(place, share.shape), float(n / (count * share.flat[place])))
        for place, n in zip(order[places], times, strict=True)
    ]


def _counts(shape: tuple[int, ...], window: tuple[slice, ...], count: float) -> Array:
    """``count`` on the pixels of a window, 0 near a side where the image goes on."""
    counts = np.zeros([s.stop - s.start for s in window])
    inner = (
        slice(INNER * (s.start > 0), s.stop - s.start - INNER * (s.stop < n))
        for n, s in zip(shape, window, strict=True)
    )
    counts[tuple(inner)] = count
    return counts


def _cut(match: Match, window: tuple[slice, ...]) -> Match:
    grid = Grid(tuple(s.stop - s.start for s in window), match.grid.spacing)
    return Match(
        grid, match.u[:, *window], match.g[:, *window], match.r[window], match.used[window]
    )
