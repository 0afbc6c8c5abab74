"""Lines of a detector: what stays in whole rows or columns where the sample moves."""

from collections.abc import Callable
from dataclasses import replace
from itertools import compress

import numpy as np

from eofm.flow.found import Estimate
from eofm.flow.start import left
from eofm.grid import Array, Mask
from eofm.imaging.lines import Lines, lines, means_along, without
from eofm.imaging.splines import Spline

# Part of what lines change by, if they stay, that the images change by: at least if they do, and at
# most if they move with the sample; and how much of their own variance is enough of a change.
OWN, NONE, SEEN = 0.75, 0.4, 5e-4
# What is left of images without lines that were theirs, at most.
WITHOUT = 0.97


def without_lines(
    I1: Array, I2: Array, dead: Mask, found: Estimate, estimate: Callable[[Array, Array], Estimate]
) -> Estimate:
    """The estimate, or that of images without lines that stay, if less of these is left.

    Single lines first: where there are large structures, lines everywhere may be of these.
    """
    taken, images = tuple[Lines, ...](), (I1, I2)
    means = means_along(*images, dead)
    for single in (True, False):
        doubted = lines(means, single)
        if doubted:
            # What the field carries along is of the sample: no other one has to be found.
            moves = changes(*without(doubted, *images), dead, found.u, doubted) < NONE
            doubted = tuple(compress(doubted, ~moves))
        while doubted:
            told, cleaned = taken + doubted, without(doubted, *images)
            other = estimate(*cleaned)
            stays = changes(*cleaned, dead, other.u, told) > OWN
            if not stays[len(taken) :].all():
                doubted = tuple(compress(doubted, stays[len(taken) :]))
                continue
            if stays.all():
                much, less = (
                    left(*each, dead, f.u)[0].std()
                    for each, f in ((images, found), (cleaned, other))
                )
                if less < WITHOUT * much:
                    found, taken, images = other, told, cleaned
                    means = means_along(*images, dead)
            break
    return replace(found, lines=tuple(sorted({line.axis for line in taken})))


def changes(I1: Array, I2: Array, dead: Mask, u: Array, doubted: tuple[Lines, ...]) -> Array:
    """Part of what lines would change by, if they stay, that images with them do change by.

    What a displacement, px, leaves of images with lines that stay are these less themselves moved,
    which is 1; of layers of the sample it leaves nothing. NaN where lines would hardly change.

    Parameters
    ----------
    I1, I2 : ndarray
        Images without the lines.
    """
    rest, used, gain = left(I1, I2, dead, u)
    if not used.any():
        return np.full(len(doubted), np.nan)
    changed = []
    for line in doubted:
        moved, _ = Spline(np.broadcast_to(line.after, I2.shape)).warp(u)
        change = np.broadcast_to(line.before, I1.shape)[used] - gain * moved[used]
        changed.append(change - change.mean())
        rest += changed[-1]
    variances = np.array([change @ change / change.size for change in changed])
    seen = variances > SEEN * np.array([line.before.var() for line in doubted])
    G = np.array([[f @ g for g in changed] for f in changed])
    own = np.linalg.lstsq(G, np.array([f @ rest for f in changed]))[0]
    return np.where(seen, own, np.nan)
