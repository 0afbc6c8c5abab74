"""Forward model of volumes: a box of which faces move, homogeneous or with inclusions.

As in `eofm.elasticity.forward`, on triquadratic bricks whose equations are solved without a matrix.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import make_interp_spline

from eofm.elasticity.bricks import Bricks, on_lines
from eofm.elasticity.material import lame, modulus
from eofm.grid import (
    FACES,
    Array,
    Edge,
    Grid,
    Mask,
    along_face,
    componentwise,
    geometric_mean,
    precision,
)
from eofm.io.limits import check_memory
from eofm.settings import Sample
from eofm.threads import serial

# Cells along each side of a cube, of the meshes of homogeneous boxes, and their ratio.
RATIO = 1.5
MESHES = (8, 12, 18, 27, 40)
# Cells shrink towards all edges with this power of the distance, as in 2-D.
GRADING = 3
# Points along each side of a brick over which its modulus is averaged.
POINTS = 4
# Memory that a brick takes in the solver and on its way to the voxels, bytes.
BRICK = 2_200
# Positions along each side at which two meshes are compared, denser towards the faces.
PROBES = 40

Motion = dict[Edge, Array]


@serial
def deform_box(
    sample: Sample,
    motion: Motion,
    error: float,
    spacing: Sequence[float] = (1.0, 1.0, 1.0),
) -> Array:
    """Displacement of a homogeneous box some of whose faces move in a known way.

    What `eofm.elasticity.forward.deform` returns for a sample that has a depth.

    Parameters
    ----------
    motion : dict of ndarray, shape (3, n, m)
        Displacement at points that divide a face evenly (1, 1: constant), px; components that
        are NaN are free.
    error : float
        Largest error wanted, px.
    spacing : (h1, h2, h3)
        Sides of a voxel in any unit.

    Returns
    -------
    ndarray of float32, shape (3, depth, height, width)
        At the voxels' centres, px.
    """
    lengths = Grid(sample.shape, tuple(spacing)).lengths
    probes = [
        np.unique(np.round((n - 1) * graded(PROBES))).astype(np.intp) for n in sample.shape[::-1]
    ]
    some = [h * i.astype(np.float64) for h, i in zip(spacing, probes, strict=True)]
    coarse = None
    for cells in MESHES:
        numbers = [max(4, round(cells * length / geometric_mean(lengths))) for length in lengths]
        sides = tuple(h * np.diff(graded(n)) for h, n in zip(lengths, numbers, strict=True))
        bricks = Bricks(sides, _lame(sample), np.ones([len(h) for h in sides[::-1]]))
        start = None if coarse is None else coarse.at(bricks.nodes)
        found = _solve(bricks, motion, spacing, start)
        u = found.at(some) / componentwise(spacing, 3)
        change = np.inf
        if coarse is not None:
            before = coarse.at(some) / componentwise(spacing, 3)
            change = np.abs(u - before).max() / (RATIO**2 - 1)
        if max(change, _missed(u, probes, motion, sample.shape)) <= error:
            break
        coarse = found
    return found.on_voxels(sample.shape, spacing)


@serial
def press_box(sample: Sample, motion: Motion, cell: float) -> Array:
    """Displacement of a box with inclusions, on bricks with sides of about ``cell`` px.

    Returns
    -------
    ndarray of float32, shape (3, depth, height, width)
        At the voxels' centres, px.
    """
    lengths = Grid(sample.shape).lengths
    numbers = [max(2, round(length / cell)) for length in lengths]
    check_cells(numbers, BRICK)
    sides = tuple(np.full(n, length / n) for length, n in zip(lengths, numbers, strict=True))
    bricks = Bricks(sides, _lame(sample), np.stack(list(_moduli(sample, sides))))
    return _solve(bricks, motion, (1.0, 1.0, 1.0)).on_voxels(sample.shape)


def check_cells(numbers: Sequence[int], each: int) -> None:
    """Refuse a mesh with so many cells along its sides, of which each takes so many bytes.

    Raises
    ------
    InputError
        If there is less memory.
    """
    what = f"{' x '.join(f'{n:.6g}' for n in numbers)} elements"
    check_memory(what, math.prod(numbers) * each, "take larger ones (true_cell)")


def graded(cells: int) -> Array:
    """Ends of cells on [0, 1] that shrink towards both ends."""
    t = np.linspace(0, 1, cells + 1)
    return t**GRADING / (t**GRADING + (1 - t) ** GRADING)


@dataclass(frozen=True)
class Solved:
    """Displacement at the nodes of a mesh, in the unit of its lengths."""

    nodes: list[Array]
    u: Array

    def at(self, x: Sequence[Array]) -> Array:
        """Cubic splines through the nodes, at a grid of positions along each component."""
        matrices = self._matrices(x)
        return np.stack([on_lines(c, matrices) for c in self.u])

    def on_voxels(self, shape: tuple[int, ...], spacing: Sequence[float] = (1, 1, 1)) -> Array:
        """The same at the voxels of a volume, px."""
        u = np.empty((3, *shape), precision(3))
        matrices = self._matrices(Grid(shape, tuple(spacing)).axes)
        for c, h in enumerate(spacing):
            on_lines(self.u[c] / h, matrices, out=u[c])
        return u

    def _matrices(self, x: Sequence[Array]) -> list[Array]:
        return [
            # Rounding must not put the last position outside.
            make_interp_spline(nodes, np.eye(len(nodes)))(np.clip(at, 0, nodes[-1]))
            for nodes, at in zip(self.nodes, x, strict=True)
        ]


def _solve(
    bricks: Bricks,
    motion: Motion,
    spacing: Sequence[float],
    start: Array | None = None,
) -> Solved:
    u, held = np.zeros((3, *bricks.shape)), np.zeros((3, *bricks.shape), dtype=bool)
    parts = [x / x[-1] for x in bricks.nodes]
    for edge, g in motion.items():
        face = FACES[edge]
        sides = [parts[i] for i in (2, 1, 0) if i != face.component]
        there = along_face(g, *sides) * componentwise(spacing, 2)
        for i in np.flatnonzero(np.isfinite(there).all((1, 2))):
            u[i, *face.pixels(3)], held[i, *face.pixels(3)] = there[i], True
    u = bricks.solve(u, held, start)
    _settle(u, bricks.nodes, held)
    return Solved(bricks.nodes, u)


def _settle(u: Array, nodes: list[Array], held: Mask) -> None:
    """Take away the motion of the whole in directions in which no face is held."""
    free = [i for i in range(3) if not held[i].any()]
    x = [n - n.mean() for n in np.meshgrid(*nodes[::-1], indexing="ij")[::-1]]
    for i in free:
        u[i] -= u[i].mean()
    for i, j in combinations(free, 2):
        turn = np.mean(x[i] * u[j] - x[j] * u[i]) / np.mean(x[i] ** 2 + x[j] ** 2)
        u[j] -= turn * x[i]
        u[i] += turn * x[j]


def _lame(sample: Sample) -> tuple[float, float]:
    """Lamé parameters of the background."""
    lam, mu = lame(sample.changed(inclusions=()), np.zeros(3))
    return float(lam), float(mu)


def _moduli(sample: Sample, sides: tuple[Array, ...]) -> Iterator[Array]:
    """Mean moduli of the bricks, layer by layer."""
    n1, n2, n3 = (len(h) for h in sides)
    x1, x2, x3 = (
        h[0] * (np.arange(POINTS * len(h)) + 0.5).reshape(len(h), POINTS) / POINTS for h in sides
    )
    for layer in range(n3):
        x = np.meshgrid(x3[layer], x2, x1, indexing="ij")[::-1]
        E = modulus(sample, np.stack(x))
        yield E.reshape(POINTS, n2, POINTS, n1, POINTS).mean((0, 2, 4))


def _missed(
    u: Array,
    probes: list[np.ndarray],
    motion: Motion,
    shape: tuple[int, ...],
) -> float:
    """Largest difference from the motion prescribed inside of faces, px."""
    parts = [i / (n - 1) for i, n in zip(probes, shape[::-1], strict=True)]
    missed = [0.0]
    for edge, g in motion.items():
        face = FACES[edge]
        sides = [parts[i] for i in (2, 1, 0) if i != face.component]
        there = u[:, *face.pixels(3)] - along_face(g, *sides)
        missed.append(np.nanmax(np.abs(there[:, 1:-1, 1:-1]), initial=0.0))
    return max(missed)
