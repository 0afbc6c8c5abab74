"""Solve ``a(u, v) = b(v)`` without a matrix: conjugate gradients and multigrid.

The preconditioner is one symmetric multigrid cycle. What makes it converge in a number of
iterations that depends neither on the size nor on the image:

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
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import DTypeLike
from scipy.linalg import cho_solve_banded, cholesky_banded

from eofm.errors import InputError
from eofm.flow import stencils
from eofm.flow.functional import Quadratic
from eofm.flow.galerkin import coarsen
from eofm.flow.stencils import SC, TC, Between, M, Operator, Real, Transfer, axis_table
from eofm.grid import Array, Mask

# Rows and columns below which there is no coarser grid.
COARSEST = 6
# Largest pointwise term, over the smoothness term, for which its average does on coarse grids.
AVERAGE = {"gradient": 1.0, "bending": 0.02}
# The same, for which few steps of the smoother do.
CONTRAST = 50.0
# The same, below which single precision does for the preconditioner: in D^-1 it costs so much
# of its 2^24. Bending needs double precision anyway, since motions across a whole image are
# (its side)^4 times softer than those from pixel to pixel.
SINGLE = 1e4
# Relative energy of motions without smoothness energy that is zero up to rounding.
SINGULAR = 1e-13
# Ratio of spacings below which a direction is coarsened together with the other.
ALIKE = math.sqrt(2) + 1e-6
# Steps of the smoother below and above this contrast, and coarse corrections per cycle.
# The fourth order needs more of each; between sharp bubbles it is stiff on small scales.
CYCLE = {"gradient": (2, 4, 1), "bending": (3, 12, 2)}


class NotConverged(InputError):  # noqa: N818 - says it all
    """The residual is still too large after the last iteration."""


def multigrid(
    F: Quadratic,
    *,
    tol: float = 1e-8,
    change: float = 0.0,
    max_iterations: int = 100,
    initial: Array | None = None,
    report: Callable[[int, float], None] | None = None,
) -> Array:
    """Minimiser of F, shape (2, height, width), to a relative residual or a change.

    Parameters
    ----------
    F : Quadratic
        With at least 2 pixels in each direction.
    tol : float
        Bound on ``|b - K v| / |b|`` in the Euclidean norm of the free values.
    change : float
        Stop as well after an iteration that changes v by no more than this, root mean square,
        px: about a tenth of that is left.
    max_iterations : int
        Of the conjugate gradients.
    initial : ndarray, shape (2, height, width), optional
        Where to start, px, if its residual is smaller than that of 0.
    report : callable, optional
        Called with the number of iterations done and the relative residual, from 0 on.

    Raises
    ------
    InputError
        If F has no unique minimiser (up to rounding).
    NotConverged
        If ``max_iterations`` reach neither ``tol`` nor ``change``.
    """
    top, operator = hierarchy(F), finest(F)
    w1, w2 = F.grid.weights
    r = F.terms.b * w1
    r *= w2[:, None]
    r *= F.free
    size = _norm(r)
    x, p, q = np.zeros_like(top.x, np.float64), np.zeros_like(top.x, np.float64), np.empty_like(r)
    if size == 0:
        return _inner(x)
    if initial is not None:
        np.multiply(initial, F.free, out=_inner(x))
        stencils.product(q, x, operator)
        np.subtract(r, q, out=q)
        if _norm(q) < size:
            r[...] = q
        else:
            x.fill(0.0)
        del initial  # maybe nobody else's
    b = r.astype(top.x.dtype, copy=False)
    residual, zr, changed = _norm(r) / size, math.inf, math.inf
    for iteration in range(max_iterations + 1):
        if report is not None:
            report(iteration, residual)
        if residual <= tol or changed <= change:
            return _inner(x)
        if iteration == max_iterations:
            break
        z = top.correct(b)
        before, zr = zr, stencils.dot(z, r).sum()
        stencils.redirect(p, z, zr / before)
        pq = stencils.product(q, p, operator).sum()
        squares = stencils.advance(x, r, b, p, q, zr / pq).sum(axis=1)
        residual, changed = math.sqrt(squares[0]) / size, math.sqrt(squares[1] / F.free.size)
    raise NotConverged(
        f"multigrid: relative residual {residual:.1e} instead of {tol:.1e}, last change"
        f" {changed:.1e} px instead of {change:.1e}, after {max_iterations} iterations"
    )


def _norm(r: Real) -> float:
    # Without BLAS, whose sums depend on the number of threads.
    return math.sqrt(np.einsum("cij,cij->", r, r))


def _inner(u: Real) -> Real:
    """The values of a field without its border of zeros."""
    return u[:, 2:-2, 2:-2]


@dataclass
class Level:
    """One grid, the operator K on it and how to correct by it.

    Attributes
    ----------
    operator : Operator
    degree, visits : int
        Steps of the smoother; corrections per correction of the finer grid.
    transfer : (lateral, axial)
        Where its nodes lie on the coarse grid.
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
        n, m = self.operator.shape
        precision = self.operator.A.dtype
        self.x, self.y = np.zeros((2, 2, n + 4, m + 4), precision)
        self.b = np.empty_like(_inner(self.coarse.x), precision, order="C")

    def correct(self, b: Real, visits: int = 1) -> Real:
        """Field close to K^-1 b: linear, symmetric and positive definite in b."""
        for visit in range(visits):
            self._smooth(b, visit == 0)
            stencils.restrict(self.b, b, self.x, self.transfer, self.operator)
            e = self.coarse.correct(self.b, self.visits)
            stencils.prolong(self.x, e, self.operator.free, self.transfer)
            self._smooth(b, False)
        return self.x

    def _smooth(self, b: Real, from_zero: bool) -> None:
        for step in range(1, self.degree + 1):
            stencils.chebyshev(self.y, self.x, b, step, from_zero and step == 1, self.operator)
            self.x, self.y = self.y, self.x


class Coarsest:
    """The coarsest grid and the Cholesky factor of K on it, a band matrix.

    Unknowns are ordered by the longer side of the grid, then the shorter one, then the
    component. The columns of K come from its products with combs, fields that are 1 on nodes
    so far apart that the stencils around them are disjoint.
    """

    def __init__(self, operator: Operator, precision: DTypeLike = np.float64) -> None:
        free = operator.free
        n, m = free.shape
        self.axes = (1, 2, 0) if n >= m else (2, 1, 0)
        number = np.empty((2, n, m), dtype=np.intp)
        ordered = number.transpose(self.axes)
        ordered[...] = np.arange(number.size).reshape(ordered.shape)
        self.x = np.zeros((2, n + 4, m + 4), precision)
        comb, q = np.empty((2, n + 4, m + 4)), np.empty((2, n, m))
        reach = 2 if operator.bending else 1
        step = 2 * reach + 1
        band = np.zeros((2 * reach * (min(n, m) + 1) + 2, 2 * n * m))
        i, j = np.ogrid[:n, :m]
        for c, k, l in np.ndindex(2, step, step):
            comb.fill(0.0)
            _inner(comb)[c, k::step, l::step] = free[k::step, l::step]
            stencils.product(q, comb, operator)
            tooth_i = i + (k - i + reach) % step - reach
            tooth_j = j + (l - j + reach) % step - reach
            inside = (tooth_i >= 0) & (tooth_i < n) & (tooth_j >= 0) & (tooth_j < m)
            column = number[c, tooth_i.clip(0, n - 1), tooth_j.clip(0, m - 1)]
            lower = inside & (number >= column)
            column = np.broadcast_to(column, number.shape)[lower]
            band[number[lower] - column, column] = q[lower]
        band[0, number[:, ~free]] = 1.0
        self.factor = cholesky_banded(band, lower=True, check_finite=False)

    def correct(self, b: Real, visits: int = 1) -> Real:
        """Field K^-1 b."""
        order = b.transpose(self.axes)
        solution = cho_solve_banded((self.factor, True), order.ravel(), check_finite=False)
        _inner(self.x).transpose(self.axes)[...] = solution.reshape(order.shape)
        return self.x


def hierarchy(F: Quadratic) -> Level | Coarsest:
    """The finest grid, linked to the coarser ones."""
    operator = finest(F)
    stiffness, area = _stiffness(operator)
    A, free = operator.A, operator.free
    degree, high_degree, visits = CYCLE[F.smoothness]
    contrast = np.max(A[0] + A[2], where=free, initial=0.0) / stiffness
    if contrast > CONTRAST:
        degree = high_degree
    energies = np.linalg.eigvalsh(_rigid_energy(F, stiffness))
    if not energies[0] > SINGULAR * max(energies[-1], stiffness * area):
        raise InputError(
            "the functional has no unique minimiser: images, bubbles and edges leave a motion"
            " undetermined; give a bubble or an edge, or a smaller mask"
        )
    precision = np.float64 if operator.bending or contrast > SINGLE else np.float32
    average = contrast <= AVERAGE[F.smoothness] and free[1:-1, 1:-1].all()
    couplings = 0 if average else 12

    levels: list[tuple[Operator, Transfer]] = []
    spacing = F.grid.spacing
    while (shape := _coarser(operator.shape, spacing)) is not None:
        (n, m), (nc, mc), (h1, h2) = operator.shape, shape, spacing
        transfer = Between.of(m, mc), Between.of(n, nc)
        A, G = np.empty((3, nc, mc)), np.empty((couplings, nc, mc))
        coarsen(A, G, operator, transfer)
        spacing = h1 * (m - 1) / (mc - 1), h2 * (n - 1) / (nc - 1)
        axes = _axes(shape, spacing, F.alpha, operator.bending)
        A /= axes[0][M]
        A /= axes[1][M, :, None]
        lateral, axial = (between.rounded(precision) for between in transfer)
        levels.append((operator.rounded(precision), (lateral, axial)))
        operator = Operator(A, G, np.ones(shape, dtype=np.bool_), axes, operator.bending)
    top: Level | Coarsest = Coarsest(operator, precision)
    for operator, transfer in reversed(levels):
        top = Level(operator, degree, visits, transfer, top)
    return top


def finest(F: Quadratic) -> Operator:
    """The operator K of a functional."""
    bending = F.smoothness == "bending"
    A = np.require(F.terms.A, np.float64, ["C", "W"])
    free = np.require(F.free, np.bool_, ["C", "W"])
    axes = _axes(F.grid.shape, F.grid.spacing, F.alpha, bending)
    return Operator(A, np.empty((0, *F.grid.shape)), free, axes, bending)


def _stiffness(K: Operator) -> tuple[float, float]:
    """The diagonal of alpha R per area, and the area of a node, inside of the image."""
    X1, X2 = (X[:, X.shape[1] // 2] for X in K.axes)
    S, T = X1[SC] / X1[M] + X2[SC] / X2[M], X1[TC] * X2[TC] / (X1[M] * X2[M])
    return float(S + T), float(X1[M] * X2[M])


def _coarser(shape: tuple[int, int], spacing: tuple[float, float]) -> tuple[int, int] | None:
    """Rows and columns of the next grid, if it is not too coarse."""
    (n, m), (h1, h2) = shape, spacing
    nc = n // 2 + 1 if h2 < ALIKE * h1 else n
    mc = m // 2 + 1 if h1 < ALIKE * h2 else m
    return None if min(nc, mc) < COARSEST else (nc, mc)


def _rigid_energy(F: Quadratic, stiffness: float) -> Array:
    """Pointwise energy of the motions without smoothness energy, a matrix.

    These are the constants (order 2) or, for bending, the linear functions (order 6). Pixels
    that are not free have a stiffness.
    """
    n, m = F.grid.shape
    w1, w2 = F.grid.weights
    x, y = np.linspace(-1, 1, m), np.linspace(-1, 1, n)
    phi1, phi2 = (np.array([1 + 0 * x, x, 1 + 0 * x]), np.array([1 + 0 * y, 1 + 0 * y, y]))
    k, l = np.indices((3, 3) if F.smoothness == "bending" else (1, 1))
    products1, products2 = w1 * phi1[k] * phi1[l], w2 * phi2[k] * phi2[l]

    def energy(A: Array | Mask) -> Array:
        return np.einsum("ikl,kli->kl", np.tensordot(A, products1, (1, 2)), products2)

    E11, E12, E22 = map(energy, F.terms.A)
    if not F.free.all():
        fixed = stiffness * energy(~F.free)
        E11, E22 = E11 + fixed, E22 + fixed
    return np.block([[E11, E12], [E12, E22]])


def _axes(
    shape: tuple[int, int], spacing: tuple[float, float], alpha: float, bending: bool
) -> tuple[Array, Array]:
    """Factors of the smoothness term of a grid, (lateral, axial)."""
    lateral, axial = (
        axis_table(n, float(h), alpha, bending) for n, h in zip(shape[::-1], spacing, strict=True)
    )
    return lateral, axial
