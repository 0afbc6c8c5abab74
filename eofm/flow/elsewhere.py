"""What two images show in different places, where no smooth field is likely to follow it."""

from itertools import product
from typing import NamedTuple

import numpy as np

from eofm.flow.start import BLOCK, Search, starts_along
from eofm.grid import Array, Mask
from eofm.imaging.intensity import normalise_locally

# Parts that are searched for elsewhere, blocks of each, and how much of a block has to lie in one;
# the correlation of what is found, how far from what the field says it is at least and from another
# block at most, samples; how many blocks tell, and which part of them that the whole has moved.
PARTS, LOOKED, HALF = 6, 24, 0.5
FOUND, AWAY, TOGETHER, TELLING, WHOLE = 0.8, 3.0, 2.0, 3, 0.2


class Elsewhere(NamedTuple):
    """Parts of an image that have moved otherwise than a field, and how, samples."""

    where: Mask
    samples: Array

    def astray(self, samples: Array) -> float:
        """Share of the image where a field, in samples, is far off that motion."""
        off = ((samples - self.samples) ** 2).sum(0) > AWAY**2
        return float((off & self.where).mean())


def elsewhere(I1: Array, I2: Array, samples: Array, found: Mask) -> Elsewhere:
    """Parts of a mask that show something which has moved otherwise than a field in ``samples``.

    Some of their blocks are found in the second image, by motions that are alike; places move as
    the nearest of them. What lies on one of the images alone is found nowhere, or in places that
    have nothing in common.
    """
    from scipy import ndimage

    label, _ = ndimage.label(found)
    windows, sizes = ndimage.find_objects(label), np.bincount(label.ravel())[1:]
    J1, J2 = (normalise_locally(I, (float(BLOCK[I.ndim]),) * I.ndim) - 0.5 for I in (I1, I2))
    search, seen = Search(J2), Elsewhere(np.zeros_like(found), samples.copy())
    for k in np.argsort(-sizes, kind="stable")[:PARTS]:
        part = label == k + 1
        firsts = np.array(_blocks(part, windows[k], search))
        if len(firsts) < TELLING:
            continue
        motion = np.zeros((len(firsts), found.ndim))
        sure = np.zeros(len(firsts), dtype=bool)
        for n, first in enumerate(firsts):
            motion[n], correlation = search.find(J1, first)
            middle = first + np.array(search.block) // 2
            off = motion[n] - samples[:, *middle]
            sure[n] = correlation > FOUND and (off**2).sum() > AWAY**2
        sure[sure] = _in_company(motion[sure])
        if np.count_nonzero(sure) < TELLING:
            continue
        if np.count_nonzero(sure) < WHOLE * len(firsts):
            # A rim of what has moved, of a part that is on one image alone.
            part &= _covered(firsts[sure], search, part.shape)
        at, middles = np.argwhere(part), firsts[sure] + np.array(search.block) / 2
        nearest = ((at[:, None] - middles) ** 2).sum(2).argmin(1)
        seen.where[part] = True
        seen.samples[:, *at.T] = motion[sure][nearest].T
    return seen


def _in_company(motion: Array) -> Mask:
    """Which of some motions, shape (n, ndim), another one is like."""
    apart = np.sqrt(((motion[:, None] - motion) ** 2).sum(2))
    np.fill_diagonal(apart, np.inf)
    return apart.min(1, initial=np.inf) < TOGETHER


def _covered(firsts: Array, search: Search, shape: tuple[int, ...]) -> Mask:
    """Pixels of some blocks."""
    covered = np.zeros(shape, dtype=bool)
    for first in firsts:
        covered[search.at(first)] = True
    return covered


def _blocks(part: Mask, window: tuple[slice, ...], search: Search) -> list[tuple[int, ...]]:
    """First samples of some blocks of which most lies inside of a part, which a window holds."""
    sides = zip(window, search.block, part.shape, strict=True)
    starts = [
        np.minimum(s.start + starts_along(s.stop - s.start, b, search.stride), n - b)
        for s, b, n in sides
    ]
    firsts = product(*map(np.ndarray.tolist, starts))
    most = [first for first in firsts if part[search.at(first)].mean() > HALF]
    return most[:: max(1, -(-len(most) // LOOKED))]
