"""Lines of a detector: what stays in whole rows or columns where the sample moves."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from eofm.flow.found import Estimate
from eofm.flow.start import left
from eofm.grid import Array, Mask
from eofm.imaging.lines import Lines, lines, means_along, without
from eofm.imaging.splines import Spline

# Part of what lines change by at least, if they stay, that the images change by; and how much of
# their own variance is enough of a change.
OWN, SEEN = 0.75, 5e-4
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
        while doubted:
            told, cleaned = taken + doubted, without(doubted, *images)
            other = estimate(*cleaned)
            stay = staying(*cleaned, dead, other.u, told)
            if stay == told:
                much, less = (
                    left(*each, dead, f.u)[0].std()
                    for each, f in ((images, found), (cleaned, other))
                )
                if less < WITHOUT * much:
                    found, taken, images = other, told, cleaned
                    means = means_along(*images, dead)
                break
            doubted = tuple(line for line in doubted if line in stay)
    return replace(found, lines=tuple(sorted({line.axis for line in taken})))


def staying(
    I1: Array, I2: Array, dead: Mask, u: Array, doubted: tuple[Lines, ...]
) -> tuple[Lines, ...]:
    """Lines that stay as they are, though a displacement, px, carries the images without them.

    What the motion leaves of the images with them are then lines less lines that it has moved, and
    nothing of that if they are layers of the sample.
    """
    rest, used, gain = left(I1, I2, dead, u)
    if not used.any():
        return ()
    changes = []
    for line in doubted:
        moved, _ = Spline(np.broadcast_to(line.after, I2.shape)).warp(u)
        change = np.broadcast_to(line.before, I1.shape)[used] - gain * moved[used]
        changes.append(change - change.mean())
        rest += changes[-1]
    variances = np.array([change @ change / change.size for change in changes])
    seen = variances > SEEN * np.array([line.before.var() for line in doubted])
    G = np.array([[f @ g for g in changes] for f in changes])
    parts = np.linalg.lstsq(G, np.array([f @ rest for f in changes]))[0]
    stay = seen & (parts > OWN)
    return tuple(line for line, told in zip(doubted, stay, strict=True) if told)
