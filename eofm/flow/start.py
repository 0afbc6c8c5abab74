"""Where to start: motions that no coarse scale would find.

A linearised image sees no farther than its structures are wide, and on scales so coarse that a
motion is short, speckle is averaged away. Blocks of a coarse image are therefore searched for in
the other one, up to a quarter of its size away, as in particle image velocimetry. Of this field
and that of coarse to fine the one is taken after which the images correlate best.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from eofm.flow.functional import Pointwise, Quadratic
from eofm.flow.multigrid import multigrid
from eofm.grid import Array, Grid, Mask, componentwise
from eofm.imaging.intensity import Window
from eofm.imaging.splines import Spline

# Sides and distances of the blocks, and width over which images are correlated, samples.
BLOCK, STRIDE, WIDTH = 24, 12, 4.0
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
    I1, I2 : ndarray, shape (height, width)
        Images whose local mean is 0, see :func:`eofm.imaging.intensity.normalise_locally`.
    grid : Grid

    Returns
    -------
    ndarray, shape (2, height, width), or None
        None where too few blocks are found or agree with their neighbours.
    """
    rows, columns = _starts(grid.shape[0]), _starts(grid.shape[1])
    u = np.zeros((2, len(rows), len(columns)))
    correlation = np.zeros(u.shape[1:])
    search = _Search(I2, grid.shape)
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            u[:, i, j], correlation[i, j] = search.find(I1, row, column)
    kept = np.nonzero(consistent(u, correlation > LEAST))
    if len(kept[0]) < FEWEST:
        return None
    A, b = np.zeros((3, *grid.shape)), np.zeros((2, *grid.shape))
    middle = [
        start + (side - 1) // 2 for start, side in zip((rows, columns), search.block, strict=True)
    ]
    at = tuple(x[k] for x, k in zip(middle, kept, strict=True))
    A[0][at] = A[2][at] = 1.0
    for f, c, h in zip(b, u, grid.spacing, strict=True):
        f[at] = h * c[kept]
    # A structure of the blocks' distance is held as firmly as by a block.
    alpha = STRIDE**2 * float(np.prod(grid.spacing)) ** 2
    F = Quadratic(grid, Pointwise(A, b), alpha, np.ones(grid.shape, dtype=bool), "bending")
    return multigrid(F, tol=1e-4)


def consistent(u: Array, found: Mask) -> Mask:
    """Which motions of a grid of blocks agree with those of their 24 neighbours.

    The normalised median test of Westerweel and Scarano (Exp. Fluids 39, 2005).
    """
    good = np.zeros_like(found)
    for i, j in zip(*np.nonzero(found), strict=True):
        rows, columns = slice(max(0, i - 2), i + 3), slice(max(0, j - 2), j + 3)
        near = found[rows, columns].copy()
        near[i - rows.start, j - columns.start] = False
        if near.sum() < 3:
            continue
        others = u[:, rows, columns][:, near]
        median = np.median(others, axis=1)
        deviation = np.median(np.abs(others - median[:, None]), axis=1)
        agrees = np.abs(u[:, i, j] - median) < TIMES * (deviation + ACCURACY)
        good[i, j] = agrees.all() and (deviation < LARGEST).all()
    return good


def correlation(I1: Array, I2: Array, u: Array, grid: Grid) -> float:
    """Mean of the local correlation of two images after a displacement; 0 where it leaves them."""
    warped, seen = Spline(I2).warp(u / componentwise(grid.spacing, 2))
    around = Window(seen, WIDTH)
    m1, m2 = around.mean(I1), around.mean(warped)
    v1, v2 = around.mean(I1**2) - m1**2, around.mean(warped**2) - m2**2
    both = np.sqrt(np.maximum(v1, TINY) * np.maximum(v2, TINY))
    return float(((around.mean(I1 * warped) - m1 * m2) / both * seen).mean())


class _Search:
    """One image, in which blocks of another are searched for by their normalised correlation."""

    def __init__(self, I2: Array, shape: tuple[int, int]) -> None:
        height, width = shape
        self.block = min(BLOCK, height), min(BLOCK, width)
        self.reach = int(np.ceil(REACH * height)), int(np.ceil(REACH * width))
        around = [(r, r) for r in self.reach]
        self.layers = np.pad(np.stack([I2, I2**2, np.ones_like(I2)]), [(0, 0), *around])
        self.size = tuple(
            fft.next_fast_len(b + 2 * r, True) for b, r in zip(self.block, self.reach, strict=True)
        )
        self.ones = np.conj(fft.rfft2(np.ones(self.block), self.size))

    def find(self, I1: Array, row: int, column: int) -> tuple[Array, float]:
        """Motion of the block at a pixel, samples, and its correlation."""
        block = I1[row : row + self.block[0], column : column + self.block[1]]
        rows, columns = (
            slice(k, k + b + 2 * r)
            for k, b, r in zip((row, column), self.block, self.reach, strict=True)
        )
        seen = fft.rfft2(self.layers[:, rows, columns], self.size)
        like = np.conj(fft.rfft2(block, self.size))
        products = fft.irfft2(seen * np.stack([like, self.ones, self.ones]), self.size)
        product, squares, inside = products[:, : 2 * self.reach[0] + 1, : 2 * self.reach[1] + 1]
        energy = max(float((block**2).sum()), TINY)
        ratio = product / np.sqrt(energy * np.maximum(squares, BLACK * energy))
        ratio[inside < INSIDE * block.size] = -1.0
        top = np.unravel_index(ratio.argmax(), ratio.shape)
        motion = [_vertex(np.moveaxis(ratio, axis, 0), top[axis], top[1 - axis]) for axis in (1, 0)]
        return np.array(motion) - self.reach[::-1], float(ratio[top])


def _vertex(ratio: Array, k: int, other: int) -> float:
    """Where along axis 0 a parabola through a largest value and its neighbours has its top."""
    if not 0 < k < len(ratio) - 1:
        return float(k)
    left, middle, right = ratio[k - 1 : k + 2, other]
    curvature = left - 2 * middle + right
    if curvature >= 0 or min(left, right) <= -1:
        return float(k)
    return float(k + np.clip(0.5 * (left - right) / curvature, -0.5, 0.5))


def _starts(n: int) -> NDArray[np.intp]:
    """First samples of the blocks along an axis of n samples."""
    last = n - min(BLOCK, n)
    return np.unique(np.linspace(0, last, max(1, round(last / STRIDE) + 1)).astype(np.intp))
