"""Where to start: motions that no coarse scale would find.

A linearised image sees no farther than its structures are wide, and on scales so coarse that a
motion is short, speckle is averaged away. Blocks of a coarse image are therefore searched for in
the other one, up to a quarter of its size away, as in particle image velocimetry. Of this field
and that of coarse to fine the one is taken after which the images correlate best.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from eofm.flow.functional import Quadratic, isotropic
from eofm.flow.multigrid import multigrid
from eofm.grid import Array, Grid, Mask
from eofm.imaging.gaussian import blur
from eofm.imaging.intensity import Window, normalise_locally
from eofm.imaging.splines import Spline

# Sides and distances of the blocks of images and of volumes, and width over which they are
# correlated, samples.
BLOCK, STRIDE, WIDTH = {2: 24, 3: 16}, {2: 12, 3: 8}, 4.0
# Part of the image's sides that a block is searched for on each side, of a block that has to lie
# inside of it, and of its squares below which what it is compared with is black.
REACH, INSIDE, BLACK = 0.25, 0.6, 0.25
# Correlation of a block with what is like it; fewer blocks than these say nothing.
LEAST, FEWEST = 0.25, 6
# How far a motion may differ from the median of its neighbours, in median deviations, to which is
# added what matching is accurate to, samples; and the largest such deviation.
TIMES, ACCURACY, LARGEST = 3.0, 0.5, 4.0
# Width over which parts of images are compared, samples, the least variance of one as a part of
# the mean, and the largest part of an image that may be unlike the other one.
PATCH, FLAT, DETAIL, MOST = 3.0, 0.01, 2.0, 0.35
# How much less than 1 their correlation is where they are likely, and certain, to show different
# things: at least, and as a multiple of the median.
UNLIKE, UNUSUAL = (0.2, 0.4), (4.0, 8.0)
# How much less than 1 that is at most where they are sure to show the same.
SURE = 0.3
# Parts that are searched for elsewhere, blocks of each, and how much of a block has to lie in one;
# the correlation of what is found, how far from what the field says it is at least and from another
# block at most, samples; how many blocks tell, and which part of them that the whole has moved.
PARTS, LOOKED, HALF = 6, 24, 0.5
FOUND, AWAY, TOGETHER, TELLING, WHOLE = 0.8, 3.0, 2.0, 3, 0.2
TINY = 1e-12


def match_blocks(I1: Array, I2: Array, grid: Grid) -> Array | None:
    """Smooth field through the motions of blocks, in the unit of the grid's spacing.

    Parameters
    ----------
    I1, I2 : ndarray, of the grid's shape
        Images whose local mean is 0, see :func:`eofm.imaging.intensity.normalise_locally`.
    grid : Grid

    Returns
    -------
    ndarray, shape (ndim, ...), or None
        None where too few blocks are found or agree with their neighbours.
    """
    search = _Search(I2)
    starts = [_starts(n, search.side, search.stride) for n in grid.shape]
    u = np.zeros((grid.ndim, *map(len, starts)))
    correlation = np.zeros(u.shape[1:])
    for k in np.ndindex(correlation.shape):
        first = tuple(int(s[i]) for s, i in zip(starts, k, strict=True))
        u[:, *k], correlation[k] = search.find(I1, first)
    kept = np.nonzero(consistent(u, correlation > LEAST))
    if len(kept[0]) < FEWEST:
        return None
    here, b = np.zeros(grid.shape, I1.dtype), np.zeros((grid.ndim, *grid.shape), I1.dtype)
    middles = (s + (side - 1) // 2 for s, side in zip(starts, search.block, strict=True))
    at = np.stack([x[k] for x, k in zip(middles, kept, strict=True)])
    motion = np.stack([c[kept] for c in u])
    for axis, side in enumerate(search.block):
        if np.ptp(at[axis]) == 0:
            # A single layer of blocks tells no slope across it: each moves as a whole.
            quarter = np.zeros((grid.ndim, 1), dtype=int)
            quarter[axis] = side // 4
            at, motion = np.hstack([at - quarter, at + quarter]), np.hstack([motion, motion])
    if np.linalg.matrix_rank(at - at[:, :1]) < grid.ndim:
        return None
    here[*at] = 1.0
    for f, c, h in zip(b, motion, grid.spacing, strict=True):
        f[*at] = h * c
    # A structure of the blocks' distance is held as firmly as by a block.
    alpha = search.stride ** (4 - grid.ndim) * float(np.prod(grid.spacing)) ** (4 / grid.ndim)
    F = Quadratic(grid, isotropic(here, b), alpha, np.ones(grid.shape, dtype=bool), "bending")
    return multigrid(F, tol=1e-4)


def consistent(u: Array, found: Mask) -> Mask:
    """Which motions of a grid of blocks agree with those of their neighbours, two on each side.

    The normalised median test of Westerweel and Scarano (Exp. Fluids 39, 2005).
    """
    good = np.zeros_like(found)
    for k in zip(*np.nonzero(found), strict=True):
        part = tuple(slice(max(0, i - 2), i + 3) for i in k)
        near = found[part].copy()
        near[tuple(i - s.start for i, s in zip(k, part, strict=True))] = False
        if near.sum() < 3:
            continue
        others = u[:, *part][:, near]
        median = np.median(others, axis=1)
        deviation = np.median(np.abs(others - median[:, None]), axis=1)
        agrees = np.abs(u[:, *k] - median) < TIMES * (deviation + ACCURACY)
        good[k] = agrees.all() and (deviation < LARGEST).all()
    return good


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
    parts, sizes = ndimage.find_objects(label), np.bincount(label.ravel())[1:]
    J1, J2 = (normalise_locally(I, (float(BLOCK[I.ndim]),) * I.ndim) - 0.5 for I in (I1, I2))
    search, moved, samples = _Search(J2), np.zeros_like(found), samples.copy()
    for k in np.argsort(-sizes, kind="stable")[:PARTS]:
        inside, firsts = label == k + 1, _blocks(label == k + 1, parts[k], search)
        motion, correlation = np.zeros((len(firsts), found.ndim)), np.zeros(len(firsts))
        off = np.zeros_like(motion)
        for n, first in enumerate(firsts):
            motion[n], correlation[n] = search.find(J1, first)
            middle = tuple(c + b // 2 for c, b in zip(first, search.block, strict=True))
            off[n] = motion[n] - samples[:, *middle]
        sure = (correlation > FOUND) & ((off**2).sum(1) > AWAY**2)
        apart = np.sqrt(((motion[:, None] - motion[sure]) ** 2).sum(2))
        sure[sure] = np.sort(apart[sure], axis=1)[:, 1:2].min(1, initial=np.inf) < TOGETHER
        if np.count_nonzero(sure) >= TELLING:
            if np.count_nonzero(sure) < WHOLE * len(firsts):
                # A rim of what has moved, of a part that is on one image alone.
                inside &= _covered(np.array(firsts)[sure], search.block, inside.shape)
            moved |= inside
            at = np.argwhere(inside)
            middles = np.array(firsts)[sure] + np.array(search.block) / 2
            nearest = ((at[:, None] - middles) ** 2).sum(2).argmin(1)
            samples[:, *at.T] = motion[sure][nearest].T
    return Elsewhere(moved, samples)


def _covered(firsts: Array, block: tuple[int, ...], shape: tuple[int, ...]) -> Mask:
    """Pixels of some blocks."""
    covered = np.zeros(shape, dtype=bool)
    for first in firsts:
        sides = zip(first, block, strict=True)
        covered[tuple(slice(c, c + b) for c, b in sides)] = True
    return covered


def _blocks(inside: Mask, part: tuple[slice, ...], search: "_Search") -> list[tuple[int, ...]]:
    """First samples of some blocks of which most lies inside of a part of an image."""
    starts = [
        np.minimum(s.start + _starts(s.stop - s.start, b, search.stride), n - b)
        for s, b, n in zip(part, search.block, inside.shape, strict=True)
    ]

    def share(first: tuple[int, ...]) -> float:
        block = zip(first, search.block, strict=True)
        return float(inside[tuple(slice(c, c + b) for c, b in block)].mean())

    most = [first for first in product(*map(np.ndarray.tolist, starts)) if share(first) > HALF]
    return most[:: max(1, -(-len(most) // LOOKED))]


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


class _Search:
    """One image, in which blocks of another are searched for by their normalised correlation."""

    def __init__(self, I2: Array) -> None:
        self.side, self.stride = BLOCK[I2.ndim], STRIDE[I2.ndim]
        self.block = tuple(min(self.side, n) for n in I2.shape)
        self.reach = tuple(int(np.ceil(REACH * n)) for n in I2.shape)
        around = [(r, r) for r in self.reach]
        self.layers = np.pad(np.stack([I2, I2**2, np.ones_like(I2)]), [(0, 0), *around])
        self.size = tuple(
            fft.next_fast_len(b + 2 * r, True) for b, r in zip(self.block, self.reach, strict=True)
        )
        self.axes = tuple(range(-I2.ndim, 0))
        self.ones = self._transform(np.ones(self.block, I2.dtype)).conj()

    def _transform(self, f: Array) -> NDArray[np.complexfloating]:
        return fft.rfftn(f, self.size, self.axes)

    def find(self, I1: Array, first: tuple[int, ...]) -> tuple[Array, float]:
        """Motion of the block from a pixel on, samples, and its correlation."""
        block = I1[tuple(slice(k, k + b) for k, b in zip(first, self.block, strict=True))]
        sides = zip(first, self.block, self.reach, strict=True)
        seen = self._transform(self.layers[:, *(slice(k, k + b + 2 * r) for k, b, r in sides)])
        like = self._transform(block).conj()
        products = fft.irfftn(seen * np.stack([like, self.ones, self.ones]), self.size, self.axes)
        product, squares, inside = products[:, *(slice(2 * r + 1) for r in self.reach)]
        energy = max(float((block**2).sum()), TINY)
        ratio = product / np.sqrt(energy * np.maximum(squares, BLACK * energy))
        ratio[inside < INSIDE * block.size] = -1.0
        top = np.unravel_index(ratio.argmax(), ratio.shape)
        lines = (ratio[(*top[:c], slice(None), *top[c + 1 :])] for c in reversed(range(len(top))))
        motion = [_vertex(line, k) for line, k in zip(lines, top[::-1], strict=True)]
        return np.array(motion) - self.reach[::-1], float(ratio[top])


def _vertex(line: Array, k: int) -> float:
    """Where a parabola through a largest value and its neighbours has its top."""
    if not 0 < k < len(line) - 1:
        return float(k)
    left, middle, right = line[k - 1 : k + 2]
    curvature = left - 2 * middle + right
    if curvature >= 0 or min(left, right) <= -1:
        return float(k)
    return float(k + np.clip(0.5 * (left - right) / curvature, -0.5, 0.5))


def _starts(n: int, side: int, stride: int) -> NDArray[np.intp]:
    """First samples of the blocks along an axis of n samples."""
    last = n - min(side, n)
    return np.unique(np.linspace(0, last, max(1, round(last / stride) + 1)).astype(np.intp))
