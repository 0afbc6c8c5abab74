"""Solve ``a(u, v) = b(v)`` without a matrix: conjugate gradients and multigrid.

The preconditioner is one symmetric multigrid cycle. What makes it converge in a number of
iterations that depends neither on the size nor on the image:

- Coarse grids share the corners of the finest one, and only directions whose spacing is
  small are coarsened, until both spacings are alike: then pointwise smoothing suffices.
- The smoothness term is discretised anew on each grid, but the pointwise term is the
  Galerkin product of bilinear interpolation. An average of the 2 x 2 matrices instead would
  forbid a sharp bubble to turn or to be strained, and cost 3 times the iterations.
- Pixels where ``v = 0`` are stiff pixels of the pointwise term on all but the finest grid.
- The smoother is the Chebyshev iteration of the fourth kind of Lottes, Numer. Linear
  Algebra Appl. 30 (2023) e2518, which needs an upper bound of the spectrum only. It is a
  polynomial in D^-1 K, hence symmetric, and a product of matrices for each step.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from eofm import stencils
from eofm.errors import InputError
from eofm.functional import Quadratic

Array = NDArray[np.float64]

# Rows and columns below which there is no coarser grid.
COARSEST = 6
# Largest pointwise term, over the smoothness term, for which few steps of the smoother do.
CONTRAST = 50.0
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
    max_iterations: int = 100,
    initial: Array | None = None,
    report: Callable[[int, float], None] | None = None,
) -> Array:
    """Minimiser of F, shape (2, height, width), to a relative residual.

    Parameters
    ----------
    F : Quadratic
        With at least 2 pixels in each direction.
    tol : float
        Bound on ``|b - K v| / |b|`` in the Euclidean norm of the free values.
    max_iterations : int
        Of the conjugate gradients.
    initial : ndarray, shape (2, height, width), optional
        Where to start, px; 0 by default.
    report : callable, optional
        Called with the number of iterations done and the relative residual, from 0 on.

    Raises
    ------
    InputError
        If F has no unique minimiser (up to rounding).
    NotConverged
        If ``max_iterations`` do not reach ``tol``.
    """
    w1, w2 = F.grid.weights
    r = np.outer(w2, w1) * F.terms.b * F.free
    size = math.sqrt(np.vdot(r, r))
    top = hierarchy(F)
    x, p, q = np.zeros_like(top.x), np.zeros_like(top.x), top.q
    if size == 0:
        return _inner(x).copy()
    if initial is not None:
        _inner(x)[...] = initial * F.free
        stencils.product(q, x, *top.operator)
        r -= q
    residual, zr = math.sqrt(np.vdot(r, r)) / size, math.inf
    for iteration in range(max_iterations + 1):
        if report is not None:
            report(iteration, residual)
        if residual <= tol:
            return _inner(x).copy()
        if iteration == max_iterations:
            break
        z = top.correct(r)
        before, zr = zr, stencils.dot(z, r).sum()
        stencils.redirect(p, z, zr / before)
        pq = stencils.product(q, p, *top.operator).sum()
        residual = math.sqrt(stencils.advance(x, r, p, q, zr / pq).sum()) / size
    raise NotConverged(
        f"multigrid: relative residual {residual:.1e} instead of {tol:.1e} "
        f"after {max_iterations} iterations"
    )


def _inner(u: Array) -> Array:
    """The values of a field without its border of zeros."""
    return u[:, 2:-2, 2:-2]


@dataclass
class Level:
    """One grid, the operator K on it (see :mod:`eofm.stencils`) and how to correct by it.

    Attributes
    ----------
    operator : tuple
        ``A, G, free, X1, X2, bending``.
    degree, visits : int
        Steps of the smoother; corrections per correction of the finer grid.
    x, y : ndarray, shape (2, n + 4, m + 4)
        Fields, the present and the last iterate.
    q : ndarray, shape (2, n, m)
        K x.
    b : ndarray, shape (2, nc, mc)
        Right-hand side of the coarse grid.
    transfer : tuple
        ``J1, t1, J2, t2`` of :func:`eofm.stencils.prolong`.
    coarse : Level or Coarsest
    """

    operator: tuple[Any, ...]
    degree: int
    visits: int
    transfer: tuple[Any, ...]
    coarse: "Level | Coarsest"

    def __post_init__(self) -> None:
        n, m = self.operator[2].shape
        self.x, self.y = np.zeros((2, 2, n + 4, m + 4))
        self.q = np.zeros((2, n, m))
        self.b = np.zeros((2, *(s - 4 for s in self.coarse.x.shape[1:])))

    def correct(self, b: Array, visits: int = 1) -> Array:
        """Field close to K^-1 b: linear, symmetric and positive definite in b."""
        self.x.fill(0.0)
        for _ in range(visits):
            self._smooth(b)
            stencils.product(self.q, self.x, *self.operator)
            stencils.restrict(self.b, b, self.q, *self.transfer)
            e = self.coarse.correct(self.b, self.visits)
            stencils.prolong(self.x, e, self.operator[2], *self.transfer)
            self._smooth(b)
        return self.x

    def _smooth(self, b: Array) -> None:
        for k in range(1, self.degree + 1):
            c1, c2 = max(0.0, (2 * k - 3) / (2 * k + 1)), (8 * k - 4) / (2 * k + 1)
            stencils.chebyshev(self.y, self.x, b, c1, c2, *self.operator)
            self.x, self.y = self.y, self.x


class Coarsest:
    """The coarsest grid and the Cholesky factor of K on it, a band matrix.

    Unknowns are ordered by the longer side of the grid, then the shorter one, then the
    component. The columns of K come from its products with combs, fields that are 1 on nodes
    so far apart that the stencils around them are disjoint.
    """

    def __init__(self, operator: tuple[Any, ...]) -> None:
        free = operator[2]
        n, m = free.shape
        self.axes = (1, 2, 0) if n >= m else (2, 1, 0)
        number = np.empty((2, n, m), dtype=np.intp)
        ordered = number.transpose(self.axes)
        ordered[...] = np.arange(number.size).reshape(ordered.shape)
        self.operator, self.x, self.q = operator, np.zeros((2, n + 4, m + 4)), np.empty((2, n, m))
        reach = 2 if operator[-1] else 1
        step = 2 * reach + 1
        band = np.zeros((2 * reach * (min(n, m) + 1) + 2, 2 * n * m))
        i, j = np.ogrid[:n, :m]
        for c, k, l in np.ndindex(2, step, step):
            self.x.fill(0.0)
            _inner(self.x)[c, k::step, l::step] = free[k::step, l::step]
            stencils.product(self.q, self.x, *operator)
            tooth_i = i + (k - i + reach) % step - reach
            tooth_j = j + (l - j + reach) % step - reach
            inside = (tooth_i >= 0) & (tooth_i < n) & (tooth_j >= 0) & (tooth_j < m)
            column = number[c, tooth_i.clip(0, n - 1), tooth_j.clip(0, m - 1)]
            lower = inside & (number >= column)
            column = np.broadcast_to(column, number.shape)[lower]
            band[number[lower] - column, column] = self.q[lower]
        band[0, number[:, ~free]] = 1.0
        self.factor = cholesky_banded(band, lower=True, check_finite=False)

    def correct(self, b: Array, visits: int = 1) -> Array:
        """Field K^-1 b."""
        order = b.transpose(self.axes)
        solution = cho_solve_banded((self.factor, True), order.ravel(), check_finite=False)
        _inner(self.x).transpose(self.axes)[...] = solution.reshape(order.shape)
        return self.x


def hierarchy(F: Quadratic) -> Level | Coarsest:
    """The finest grid, linked to the coarser ones."""
    free = np.array(F.free, order="C")
    bending = F.smoothness == "bending"
    X1, X2 = _tables(free.shape, F.grid.spacing, F.alpha, bending)
    # The diagonal of alpha R.
    stiffness = np.outer(X2[0], X1[3]) + np.outer(X2[3], X1[0]) + np.outer(X2[7], X1[7])
    A = np.outer(X2[0], X1[0]) * F.terms.A
    degree, high_degree, visits = CYCLE[F.smoothness]
    if (A[0] + A[2] > CONTRAST * stiffness)[free].any():
        degree = high_degree
    A[:, ~free] = np.array([[1.0], [0.0], [1.0]]) * stiffness[~free]
    energies = np.linalg.eigvalsh(_rigid_energy(A, bending))
    if not energies[0] > SINGULAR * max(energies[-1], stiffness.max()):
        raise InputError(
            "the functional has no unique minimiser: images, bubbles and edges leave a motion"
            " undetermined; give a bubble or an edge, or a smaller mask"
        )

    def grid(T: Array, free: NDArray[np.bool_], h1: float, h2: float) -> Level | Coarsest:
        """The grid with the pointwise term T, shape (3, 3, 3, n, m) or (3, 1, 1, n, m).

        T[:, 1 + a, 1 + b, i, j] couples the nodes (i, j) and (i + a, j + b).
        """
        n, m = free.shape
        ahead = stencils.AHEAD if T.shape[1] == 3 else ()
        G = np.concatenate([np.empty((0, n, m)), *(T[:, 1 + a, 1 + b] for a, b in ahead)])
        tables = _tables(free.shape, (h1, h2), F.alpha, bending)
        operator = (T.sum((1, 2)), G, free, *tables, bending)
        nc = n // 2 + 1 if h2 < ALIKE * h1 else n
        mc = m // 2 + 1 if h1 < ALIKE * h2 else m
        if min(nc, mc) < COARSEST:
            return Coarsest(operator)
        J1, t1, J2, t2 = transfer = (*_between(m, mc), *_between(n, nc))
        T = stencils.coarsen(T.reshape(-1, T.shape[2], n, m), J1, t1, mc)
        T = T.reshape(3, -1, 3, mc, n).swapaxes(1, 2)
        T = stencils.coarsen(np.ascontiguousarray(T).reshape(9, -1, mc, n), J2, t2, nc)
        T = np.ascontiguousarray(T.reshape(3, 3, 3, nc, mc).swapaxes(1, 2))
        ones = np.ones((nc, mc), dtype=np.bool_)
        coarse = grid(T, ones, h1 * (m - 1) / (mc - 1), h2 * (n - 1) / (nc - 1))
        return Level(operator, degree, visits, transfer, coarse)

    return grid(A[:, None, None], free, *map(float, F.grid.spacing))


def _rigid_energy(A: Array, bending: bool) -> Array:
    """Pointwise energy of the motions without smoothness energy, a matrix.

    These are the constants (order 2) or, for bending, the linear functions (order 6).
    """
    n, m = A.shape[1:]
    x, y = np.linspace(-1, 1, m), np.linspace(-1, 1, n)
    phi1, phi2 = (np.array([1 + 0 * x, x, 1 + 0 * x]), np.array([1 + 0 * y, 1 + 0 * y, y]))
    k, l = np.indices((3, 3) if bending else (1, 1))
    rows = np.tensordot(A, phi1[k] * phi1[l], (2, 2))
    E11, E12, E22 = np.einsum("cikl,kli->ckl", rows, phi2[k] * phi2[l])
    return np.block([[E11, E12], [E12, E22]])


def _tables(
    shape: tuple[int, int], spacing: tuple[float, float], alpha: float, bending: bool
) -> tuple[Array, Array]:
    """The tables X1 and X2 of a grid."""
    X1, X2 = (
        stencils.axis_table(n, float(h), alpha, bending)
        for n, h in zip(shape[::-1], spacing, strict=True)
    )
    return X1, X2


def _between(n: int, nc: int) -> tuple[NDArray[np.intp], Array]:
    """Where n nodes lie among nc nodes that share the ends: J, t of stencils.prolong."""
    position = np.arange(n) * (nc - 1) / (n - 1)
    J = np.minimum(position.astype(np.intp), nc - 2)
    return J, position - J
