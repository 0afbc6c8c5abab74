"""Lines of a detector: what stays, or flickers, in whole rows or columns as the sample moves."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce
from itertools import compress

import numpy as np

from eofm.flow.found import Estimate
from eofm.flow.images import resized
from eofm.flow.likeness import left
from eofm.flow.pair import LIVE
from eofm.grid import Array, Mask
from eofm.imaging.flicker import flickers, in_both, level, without_changes
from eofm.imaging.lines import Lines, lines, means_along, without
from eofm.imaging.splines import Spline

# Part of what lines change by, if they stay, that the images change by: at least if they do, and at
# most if they move with the sample; and how much of their own variance is enough of a change.
OWN, NONE, SEEN = 0.75, 0.4, 5e-4
# What is left of images without lines that were theirs, at most.
WITHOUT = 0.97
# The same of lines that flicker, which a displacement may have followed to leave less.
ALIKE = 1.01
# How far fields of images without all that is the same along lines, and without what flickers, are
# from each other at most, px, in the median: of images that show different things, lines explain
# anything.
AGREE = 0.5
# Times that lines which flicker are taken off: contrast is to first order each time.
PASSES = 3

Both = tuple[Array, Array]


def without_lines(
    I1: Array, I2: Array, dead: Mask, estimate: Callable[[Array, Array], Estimate]
) -> Estimate:
    """The estimate, or that of images without lines, if less of these is left."""
    found, images = without_lines_that_stay((I1, I2), dead, estimate(I1, I2), estimate)
    return without_flicker(images, dead, found, estimate)


def without_lines_that_stay(
    images: Both, dead: Mask, found: Estimate, estimate: Callable[[Array, Array], Estimate]
) -> tuple[Estimate, Both]:
    """The estimate, or that of images without lines that stay, if less is left; and these images.

    Single lines first: where there are large structures, lines everywhere may be of these.
    """
    taken = tuple[Lines, ...]()
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
    return replace(found, lines=tuple(sorted({line.axis for line in taken}))), images


def without_flicker(
    images: Both, dead: Mask, found: Estimate, estimate: Callable[[Array, Array], Estimate]
) -> Estimate:
    """The estimate, or that of images without lines that flicker, if less of these is left.

    A displacement that follows lines hides them. So they are looked for after that of images whose
    lines have one brightness and contrast, too; where structures lie along lines, that loses these.
    """
    unused = [resized(~live, dead.shape) for live in (found.pair.live, found.pair.live_after)]
    dead = dead | unused[0]
    if unused[1].any():
        dead = dead | (Spline(unused[1].astype(found.u.dtype)).warp(found.u)[0] > 1 - LIVE)
    seen, rest, used = _compared(images, dead, found.u)
    axes = flickers(seen, rest, used) if used.any() else ()
    if not axes:
        return found
    each = zip(images, unused, strict=True)
    even = estimate(*(reduce(partial(level, dead=mask), axes, I) for I, mask in each))
    ways = [(_steady(images, dead, f.u, axes), f) for f in (found, even)]
    steady, _ = min(ways, key=lambda way: _left(way[0], dead, way[1].u))
    other = estimate(*steady)
    apart = float(np.median(np.linalg.norm(other.u - even.u, axis=0)))
    if apart > AGREE or _left(steady, dead, other.u) > ALIKE * _left(steady, dead, found.u):
        return found
    return replace(other, lines=tuple(sorted({*found.lines, *axes})))


def _compared(images: Both, dead: Mask, u: Array) -> tuple[Array, Array, Mask]:
    """What two images show after a displacement, but for its mean; what it leaves; and where."""
    rest, used, _ = left(*images, dead, u)
    return in_both(images[0][used], rest), rest, used


def _steady(images: Both, dead: Mask, u: Array, axes: tuple[int, ...]) -> Both:
    """The images without lines that flicker along some axes, as a displacement tells them."""
    for axis in axes:
        for _ in range(PASSES):
            images = without_changes(images, *_compared(images, dead, u), u, axis)
    return images


def _left(images: Both, dead: Mask, u: Array) -> float:
    """Standard deviation that a displacement leaves, as a part of the first image's."""
    return float(left(*images, dead, u)[0].std() / images[0].std())


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
