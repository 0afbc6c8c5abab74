"""Where to start: motions that no coarse scale would find.

A linearised image sees no farther than its structures are wide, and on scales so coarse that a
motion is short, speckle is averaged away. Blocks of a coarse image are therefore searched for in
the other one, up to a quarter of its size away, as in particle image velocimetry. Of this field
and that of coarse to fine the one is taken after which the images correlate best.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from eofm.flow.functional import Quadratic, isotropic
from eofm.flow.multigrid import multigrid
from eofm.grid import Array, Grid, Mask

# Sides and distances of the blocks of images and of volumes, samples.
BLOCK, STRIDE = {2: 24, 3: 16}, {2: 12, 3: 8}
# Part of the image's sides that a block is searched for on each side, of a block that has to lie
# inside of it, and of its squares below which what it is compared with is black.
REACH, INSIDE, BLACK = 0.25, 0.6, 0.25
# Correlation of a block with what is like it; fewer blocks than these say nothing.
LEAST, FEWEST = 0.25, 6
# How far a motion may differ from the median of its neighbours, in median deviations, to which is
# added what matching is accurate to, samples; and the largest such deviation.
TIMES, ACCURACY, LARGEST = 3.0, 0.5, 4.0
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
    search = Search(I2)
    starts = [starts_along(n, search.side, search.stride) for n in grid.shape]
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


class Search:
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

    def at(self, first: Sequence[int]) -> tuple[slice, ...]:
        """Index of the block from a pixel on."""
        return tuple(slice(k, k + b) for k, b in zip(first, self.block, strict=True))

    def find(self, I1: Array, first: Sequence[int]) -> tuple[Array, float]:
        """Motion of the block from a pixel on, samples, and its correlation."""
        block = I1[self.at(first)]
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


def starts_along(n: int, side: int, stride: int) -> NDArray[np.intp]:
    """First samples of the blocks along an axis of n samples."""
    last = n - min(side, n)
    return np.unique(np.linspace(0, last, max(1, round(last / stride) + 1)).astype(np.intp))
