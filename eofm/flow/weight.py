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
from numpy.typing import NDArray

from eofm.flow.matching import BLOCK, Match
from eofm.flow.parts import cut_out, windows
from eofm.flow.trial import RIDGE, Blocks, Trial, folds
from eofm.grid import Array
from eofm.settings import ALPHA

# Ratio of two weights that are compared: the minimum is flat; and how far they go from the
# first, in such steps.
STEP, FARTHEST = 3.0, 6
# A misfit as large as that of a motion which is off by so many samples may be a motion that was
# lost; by how many steps less it is looked for, and the part of the misfit that tells. The least
# weights follow noise, and their solves take longest: none of a hundred scenes had a better one
# beyond a weight whose misfit was 1.13 times that from which it was looked for.
LOST, PROBES, TELLS, HOPELESS = 0.25, (2, 4, 6, 8, 10, 12), 0.9, 1.4
# Part of the misfit that is left at most if a weight that varies is to be believed, and by how many
# steps it is less than one that does not vary: along a crack that is too large.
GAIN, EASIER = 0.999, (0, 1, 2)
# By how little weights larger by so many steps change the misfit where the motion is as stiff as
# one can make it, so that nothing leads downhill.
STIFF, UP = 1e-3, (1, 4)
# Misfit, as a part of the least, up to which a weight that other scales ask for is as good.
EQUAL = 1.1
# Pixels around a held-out block that are not used either: the noise of images that were
# filtered is correlated, and would be fitted on both sides of the border.
MARGIN = 2
# Sides of blocks, and margins: those, and some that are short for a wavelength of 20 samples, which
# could not be told from what lies around larger ones; and how much less the weight is that those
# find where motion was lost. Where the finest scale finds one as much less than a coarser one did,
# blocks of twice the side decide if structures are as wide as a block: what is left of such that
# change is told in small blocks by what is around them, as motion is.
USUAL, SMALL, LARGE, FOUND = (BLOCK, MARGIN), (4, 1), (2 * BLOCK, 2 * MARGIN), STEP**4
# Structures as wide as a block: gradients half of it apart correlate more than this part of how
# those two samples apart do. Speckle 9 samples wide has 0.5 to 0.8, such of 2 none.
WIDE = 0.5


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
    parts = windows(match)

    def trials(ease: Array | float, blocks: Blocks) -> list[Trial]:
        eased = match if isinstance(ease, float) else match.eased(ease)
        ridge = RIDGE * eased.strength
        shares = np.broadcast_to(ease, match.grid.shape)
        return [
            Trial(
                cut_out(eased, w),
                about[:, *w],
                prescribed[:, *w],
                free[w],
                fold,
                ridge,
                counts / shares[w],
                blocks,
            )
            for w, counts in parts
            for fold in folds(match.grid.shape, len(parts))
        ]

    even, blocks = best_weight(partial(trials, 1.0), start, before)
    if ease is None:
        return even
    uneven = trials(ease, blocks)
    for start in (even.best / STEP**k for k in EASIER):
        if sum(t.misfit(start) for t in uneven) <= GAIN * even.misfit:
            return least_misfit(uneven, start, before or (even.best,))._replace(eased=True)
    return even


class Choice(NamedTuple):
    """The best weight by itself, that to use, the misfit, whether the weight is to vary."""

    best: float
    alpha: float
    misfit: float
    eased: bool = False


def best_weight(
    trials: Callable[[Blocks], Sequence[Trial]], start: float, before: Sequence[float]
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
    trials: Sequence[Trial],
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
        low = _far_below(low, misfit, HOPELESS * misfit(k))
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


def _far_below(k: int, misfit: Callable[[int], float], hopeless: float) -> int:
    """The best of some weights far below one, up to the first that is hopeless."""
    probes = list[int]()
    for far in PROBES:
        probes.append(k - far)
        if misfit(k - far) > hopeless:
            break
    return min(probes, key=misfit)
