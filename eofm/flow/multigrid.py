"""Solve ``a(u, v) = b(v)`` without a matrix: conjugate gradients and multigrid.

The preconditioner is one symmetric cycle through the grids of :mod:`eofm.flow.hierarchy`.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import DTypeLike

from eofm.errors import InputError
from eofm.flow.functional import Quadratic
from eofm.flow.hierarchy import LOOPS, Level, Levels, hierarchy
from eofm.flow.operator import Real, inner
from eofm.grid import Array


class NotConverged(InputError):  # noqa: N818 - says it all
    """The residual is still too large after the last iteration."""


def multigrid(
    F: Quadratic,
    *,
    tol: float = 1e-8,
    change: float = 0.0,
    max_iterations: int = 100,
    initial: Array | None = None,
    levels: "Levels | None" = None,
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
    levels : Levels, optional
        The :func:`hierarchy` of an F that differs in b only, where several are minimised.
    report : callable, optional
        Called with the number of iterations done and the relative residual, from 0 on.

    Raises
    ------
    InputError
        If F has no unique minimiser (up to rounding).
    NotConverged
        If ``max_iterations`` reach neither ``tol`` nor ``change``.
    """
    loops, operator = LOOPS[F.grid.ndim], F.operator()
    top = levels or hierarchy(F)
    precision = operator.A.dtype
    r = _load(F, precision)
    size = loops.norm(r)
    x, p = (np.zeros_like(top.x, precision) for _ in range(2))
    # In volumes K p takes the place of an iterate that serves nobody between corrections.
    fits = r.ndim == 4 and top.x.dtype == precision
    lender = top if fits and isinstance(top, Level) else None
    q = lender.y if lender else np.empty_like(r)
    if size == 0:
        return inner(x)
    if initial is not None:
        np.multiply(initial, F.free, out=inner(x), casting="same_kind")
        loops.product(q, x, operator)
        rest = inner(q) if lender else q
        np.subtract(r, rest, out=rest)
        if loops.norm(q) < size:
            r[...] = rest
        else:
            x.fill(0.0)
        del initial  # maybe nobody else's
    b = r.astype(top.x.dtype, copy=False)
    residual, zr, changed = loops.norm(r) / size, math.inf, math.inf
    for iteration in range(max_iterations + 1):
        if report is not None:
            report(iteration, residual)
        if residual <= tol or changed <= change:
            return inner(x)
        if iteration == max_iterations:
            break
        z = top.correct(b)
        before, zr = zr, loops.dot(z, r).sum()
        loops.redirect(p, z, zr / before)
        q = lender.y if lender else q
        pq = loops.product(q, p, operator).sum()
        squares = loops.advance(x, r, b, p, q, zr / pq).reshape(2, -1).sum(axis=1)
        residual, changed = math.sqrt(squares[0]) / size, math.sqrt(squares[1] / F.free.size)
    raise NotConverged(
        f"multigrid: relative residual {residual:.1e} instead of {tol:.1e}, last change"
        f" {changed:.1e} px instead of {change:.1e}, after {max_iterations} iterations"
    )


def _load(F: Quadratic, precision: DTypeLike) -> Real:
    """The right-hand side: b integrated, 0 where v is."""
    r = F.terms.b
    for component, weights in enumerate(F.grid.weights):
        w = weights.astype(precision).reshape(-1, *[1] * component)
        r = np.multiply(r, w, out=r if component else None, order="C")
    r *= F.free
    return r
