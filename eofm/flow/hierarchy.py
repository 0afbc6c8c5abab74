"""Grids that are ever coarser, with K on each of them: one cycle through them is close to K^-1.

What makes conjugate gradients with it converge in a number of iterations that depends neither on
the size nor on the image:

- Coarse grids share the corners of the finest one, and only directions whose spacing is
  small are coarsened, until both spacings are alike: then pointwise smoothing suffices.
- The smoothness term is discretised anew on each grid, but the pointwise term is the
  Galerkin product of bilinear interpolation. An average of the 2 x 2 matrices instead would
  forbid a sharp bubble to turn or to be strained, and cost 3 times the iterations; where the
  smoothness term is so large that it forbids that itself, the average is as good and faster.
  Not so inside of the image beside pixels where ``v = 0``, which are as stiff as need be.
- Pixels where ``v = 0`` are stiff pixels of the pointwise term on all but the finest grid.
- The smoother is the Chebyshev iteration of the fourth kind of Lottes, Numer. Linear
  Algebra Appl. 30 (2023) e2518, which needs an upper bound of the spectrum only. It is a
  polynomial in D^-1 K, hence symmetric, and a product of matrices for each step.
"""

import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from eofm.errors import InputError
from eofm.flow import galerkin, galerkin3, stencils, stencils3
from eofm.flow.coarsest import Coarsest, pointwise_band
from eofm.flow.functional import Quadratic, pairs
from eofm.flow.operator import (
    SC,
    TC,
    Between,
    M,
    Operator,
    Real,
    Transfer,
    axis_tables,
    inner,
)
from eofm.flow.sweeps import smooth
from eofm.grid import Array, Mask

# The compiled loops for images and volumes.
LOOPS = {2: stencils, 3: stencils3}
COARSEN = {2: galerkin.coarsen, 3: galerkin3.coarsen}
COUPLINGS = {2: 12, 3: 42}
# Rows and columns below which an image has no coarser grid.
COARSEST = 6
# Nodes of a volume that need no coarser grid, and those along an axis that is not coarsened.
FEW, THIN = 330, 3
# Largest pointwise term, over the smoothness term, for which its average does on coarse grids. In
# volumes couplings cost more: half the time of an iteration, and 25 bytes a voxel.
AVERAGE = {
    2: {"gradient": 1.0, "bending": 0.02},
    3: {"gradient": 5.0, "bending": 0.04},
}
# The same, for which few steps of the smoother do.
CONTRAST = 50.0
# The same, below which single precision does for the preconditioner: in D^-1 it costs so much
# of its 2^24. Bending needs double precision anyway, since motions across a whole image are
# (its side)^4 times softer than those from pixel to pixel.
SINGLE = 1e4
# Relative energy of motions without smoothness energy that is zero up to rounding.
SINGULAR = {np.dtype(np.float64): 1e-13, np.dtype(np.float32): 1e-7}
# Part of the pixels with data below which a mask may be the wrong way round.
SCARCE = 0.1
# Ratio of spacings below which a direction is coarsened together with the other.
ALIKE = math.sqrt(2) + 1e-6
# Steps of the smoother below and above this contrast, and coarse corrections per cycle.
# The fourth order needs more of each; between sharp bubbles it is stiff on small scales.
CYCLE = {
    2: {"gradient": (2, 4, 1), "bending": (3, 12, 2)},
    3: {"gradient": (2, 4, 1), "bending": (4, 12, 2)},
}
# A second correction of a volume is an eighth of the work, but a quarter or half of it where two
# directions or one are coarsened, as those of flat voxels: there, every other grid has one. So it
# is from so many nodes along these directions on, and along the others. Cubes have no such grids:
# sides that pyramids keep, and the spacing with them, are shorter.
DEAR, WHOLE = 36, 6


@dataclass
class Level:
    """One grid, the operator K on it and how to correct by it.

    Attributes
    ----------
    operator : Operator
    degree, visits : int
        Steps of the smoother; corrections by the coarse grid for each one by this grid.
    transfer : tuple of Between
        Where its nodes lie on the coarse grid, along each component.
    coarse : Level or Coarsest
    x, y : ndarray, shape (2, n + 4, m + 4)
        Fields, the present and the last iterate.
    b : ndarray, shape (2, nc, mc)
        Right-hand side of the coarse grid.
    """

    operator: Operator
    degree: int
    visits: int
    transfer: Transfer
    coarse: "Level | Coarsest"
    x: Real = field(init=False)
    y: Real = field(init=False)
    b: Real = field(init=False)

    def __post_init__(self) -> None:
        shape = self.operator.shape
        precision = self.operator.A.dtype
        self.loops = LOOPS[len(shape)]
        self.x, self.y = np.zeros((2, len(shape), *(n + 4 for n in shape)), precision)
        self.b = np.empty_like(inner(self.coarse.x), precision, order="C")

    def correct(self, b: Real, visits: int = 1) -> Real:
        """Field close to K^-1 b: linear, symmetric and positive definite in b."""
        for visit in range(visits):
            self._smooth(b, from_zero=visit == 0)
            self.loops.restrict(self.b, b, self.x, self.transfer, self.operator)
            e = self.coarse.correct(self.b, self.visits)
            self.loops.prolong(self.x, e, self.operator.free, self.transfer)
            self._smooth(b, from_zero=False)
        return self.x

    def _smooth(self, b: Real, from_zero: bool) -> None:
        steps, sweep = range(1, self.degree + 1), self.loops.sweep
        self.x, self.y = smooth(sweep, self.x, self.y, b, steps, from_zero, self.operator)


Levels = Level | Coarsest


@dataclass
class CoarseTerms:
    """What hierarchies of one pointwise term share, whatever the weight of the smoothness term.

    Attributes
    ----------
    energy : ndarray or None
        Of the motions without smoothness energy.
    terms : dict
        A and G of each coarse grid, by the number of couplings and that of the grid.
    bands : dict
        That of the coarsest grid, by the number of couplings.
    """

    energy: Array | None = None
    terms: dict[tuple[int, int], tuple[Real, Real]] = field(default_factory=dict)
    bands: dict[int, Array] = field(default_factory=dict)


def hierarchy(F: Quadratic, known: CoarseTerms | None = None) -> Levels:
    """The finest grid, linked to the coarser ones.

    ``known`` is what an F has left that differs in alpha and b only. It serves where all pixels are
    free: the stiffness of others goes by alpha.
    """
    operator = F.operator()
    stiffness, area = _stiffness(operator)
    A, free, own = operator.A, operator.free, operator.A.dtype
    degree, high_degree, visits = CYCLE[free.ndim][F.smoothness]
    trace = sum(a for a, (i, j) in zip(A, pairs(F.grid.ndim), strict=True) if i == j)
    contrast = np.max(trace, where=free, initial=0.0) / stiffness
    del trace
    if contrast > CONTRAST:
        degree = high_degree
    known = known if known is not None and free.all() else CoarseTerms()
    if known.energy is None:
        known.energy = _rigid_energy(F, stiffness)
    energies = np.linalg.eigvalsh(known.energy)
    if not energies[0] > SINGULAR[own] * max(energies[-1], stiffness * area):
        raise InputError(f"the functional has no unique minimiser: {_undetermined(A)}")
    double = own == np.float64 and (operator.bending or contrast > SINGLE)
    precision = np.float64 if double else np.float32
    average = (
        contrast <= AVERAGE[free.ndim][F.smoothness] and free[*[slice(1, -1)] * free.ndim].all()
    )
    couplings = 0 if average else COUPLINGS[free.ndim]

    grids: list[tuple[Operator, Transfer, int]] = []
    once = False
    spacing = F.grid.spacing
    while (shape := _coarser(operator.shape, spacing)) is not None:
        sides = list(zip(operator.shape[::-1], shape[::-1], strict=True))
        transfer = tuple(Between.of(n, coarse) for n, coarse in sides)
        spacing = tuple(
            h * (n - 1) / (coarse - 1) for h, (n, coarse) in zip(spacing, sides, strict=True)
        )
        axes = axis_tables(shape, spacing, F.alpha, operator.bending)
        number = couplings, len(grids)
        if number not in known.terms:
            A, G = np.empty((len(A), *shape), own), np.empty((couplings, *shape), own)
            COARSEN[free.ndim](A, G, operator, transfer)
            for component, axis in enumerate(axes):
                A /= axis[M].astype(own).reshape(-1, *[1] * component)
            known.terms[number] = A, G
        A, G = known.terms[number]
        rounded = tuple(between.rounded(precision) for between in transfer)
        once = not once and _dear(operator.shape, shape)
        grids.append((operator.rounded(precision), rounded, 1 if once else visits))
        operator = Operator(A, G, np.ones(shape, dtype=np.bool_), axes, operator.bending)
    product = LOOPS[free.ndim].product
    if couplings not in known.bands:
        known.bands[couplings] = pointwise_band(operator, spacing, product)
    band = known.bands[couplings]
    top: Levels = Coarsest(operator, spacing, F.alpha, product, band, precision)
    for operator, transfer, visits in reversed(grids):
        top = Level(operator, degree, visits, transfer, top)
    return top


def _undetermined(A: Real) -> str:
    """Why images of a pointwise term may leave a motion open, and what to do."""
    share = float(np.mean((A != 0).any(axis=0)))
    if share < SCARCE:
        some = f"only {share:.1%} of the pixels carry"
        few = some if share > 0.001 else "hardly any pixel carries"
        return (
            f"{few} data; is the mask the wrong way round? It covers what to leave out; else give a"
            " smaller one, a bubble or an edge"
        )
    return (
        "images, bubbles and edges leave a motion undetermined; give a bubble or an edge, or a"
        " smaller mask"
    )


def _stiffness(K: Operator) -> tuple[float, float]:
    """The diagonal of alpha R per area, and the area of a node, inside of the image."""
    inside = [X[:, X.shape[1] // 2] for X in K.axes]
    S = sum(X[SC] / X[M] for X in inside)
    T = sum(X[TC] * Y[TC] / (X[M] * Y[M]) for X, Y in combinations(inside, 2))
    return float(S + T), float(math.prod(X[M] for X in inside))


def _coarser(shape: tuple[int, ...], spacing: tuple[float, ...]) -> tuple[int, ...] | None:
    """The shape of the next grid, if it is not too coarse.

    An axis of a volume that is short keeps its nodes, and the others go on without it.
    """
    image = len(shape) == 2
    room = [image or n // 2 + 1 >= THIN for n in shape[::-1]]
    if not any(room) or (not image and math.prod(shape) <= FEW):
        return None
    least = min(h for h, has in zip(spacing, room, strict=True) if has)
    coarse = tuple(
        n // 2 + 1 if has and h < ALIKE * least else n
        for n, h, has in zip(shape[::-1], spacing, room, strict=True)
    )[::-1]
    return None if image and min(coarse) < COARSEST else coarse


def _dear(shape: tuple[int, ...], coarse: tuple[int, ...]) -> bool:
    """Whether the next grid of a volume has far more than an eighth of the nodes, and many."""
    sides = list(zip(shape, coarse, strict=True))
    kept = [n for n, fewer in sides if fewer == n]
    others = [n for n, fewer in sides if fewer < n]
    return len(shape) == 3 and min(kept, default=0) >= WHOLE and min(others) >= DEAR


def _rigid_energy(F: Quadratic, stiffness: float) -> Array:
    """Pointwise energy of the motions without smoothness energy, a matrix.

    These are the constants or, for bending, the linear functions (order 6, or 12 of a volume).
    Pixels that are not free have a stiffness.
    """
    n = F.grid.ndim
    axes = [np.linspace(-1, 1, side) for side in F.grid.shape[::-1]]
    powers = [w * x ** np.arange(3)[:, None] for w, x in zip(F.grid.weights, axes, strict=True)]
    functions = np.eye(n + 1 if F.smoothness == "bending" else 1, n, k=-1, dtype=int)
    product = functions[:, None] + functions

    def energy(A: Array | Mask) -> Array:
        """From the moments of A, slice by slice: sums in double precision."""
        slices = (a.astype(np.float64, copy=False) for a in A.reshape(-1, *A.shape[-2:]))
        moments = np.stack([powers[1] @ a @ powers[0].T for a in slices])
        for further in powers[2:]:
            moments = np.tensordot(further, moments, 1)
        moments = moments.reshape([3] * n)
        return moments[*np.moveaxis(product[..., ::-1], -1, 0)]

    E = np.empty((n, n, *product.shape[:2]))
    for A, (i, j) in zip(F.terms.A, pairs(n), strict=True):
        E[i, j] = E[j, i] = energy(A)
    if not F.free.all():
        E[range(n), range(n)] += stiffness * energy(~F.free)
    return np.block([list(row) for row in E])
