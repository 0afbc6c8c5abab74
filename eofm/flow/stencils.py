"""Loops over the pixel grid for :mod:`eofm.flow.multigrid`, compiled and shared by rows.

Two kinds of arrays hold a vector field on a grid of n rows and m columns. *Fields* have
shape (2, n + 4, m + 4): two rows and columns of zeros around the nodes spare the stencils
all questions at the edges. *Functionals* (right-hand sides, ``K u``) have shape (2, n, m).

All arrays may have single or double precision, those of one operator the same one.

Every row is computed by one thread, and sums over rows are left to the caller: results
do not depend on the number of threads.
"""

import math

import numpy as np
from numba import njit

from eofm.compiled import compiled, share
from eofm.flow.operator import (
    S_SUM,
    SA,
    SB,
    SC,
    SD,
    SE,
    T_SUM,
    TB,
    TC,
    TD,
    M,
    Operator,
    Real,
    Transfer,
)
from eofm.grid import Array, Mask

# Rows and columns from a node to those of its eight neighbours that come after it.
AHEAD = ((0, 1), (1, -1), (1, 0), (1, 1))
# Rows of a coarse grid that are made together.
STRIP = 16
TWO = np.uintp(2)


@njit
def _smoothness(s, u, i, axes, bending):
    """Row i of alpha R u for one component: u is (n + 4, m + 4), s is (m,)."""
    ua, ub, uc, ud, ue = u[i], u[i + 1], u[i + 2], u[i + 3], u[i + 4]
    X1, X2 = axes
    m, w = X1[M], X2[M, i]
    Sa, Sb, Sc, Sd, Se = X1[SA], X1[SB], X1[SC], X1[SD], X1[SE]
    Tb, Tc, Td = X1[TB], X1[TC], X1[TD]
    sa, sb, sc, sd, se = X2[SA, i], X2[SB, i], X2[SC, i], X2[SD, i], X2[SE, i]
    tb, tc, td = X2[TB, i], X2[TC, i], X2[TD, i]
    for j in range(s.size):
        s[j] = w * (Sb[j] * uc[j + 1] + Sc[j] * uc[j + 2] + Sd[j] * uc[j + 3]) + m[j] * (
            sb * ub[j + 2] + sc * uc[j + 2] + sd * ud[j + 2]
        )
    if bending:
        for j in range(s.size):
            s[j] += (
                w * (Sa[j] * uc[j] + Se[j] * uc[j + 4])
                + m[j] * (sa * ua[j + 2] + se * ue[j + 2])
                + Tb[j] * (tb * ub[j + 1] + tc * uc[j + 1] + td * ud[j + 1])
                + Tc[j] * (tb * ub[j + 2] + tc * uc[j + 2] + td * ud[j + 2])
                + Td[j] * (tb * ub[j + 3] + tc * uc[j + 3] + td * ud[j + 3])
            )


@njit
def _springs(s, u, G, o, rows, columns):
    """Add ``G (u_q - u_p)`` to s on ``size`` nodes from node p of row i, q of row l onwards.

    The blocks G in direction o belong to the nodes of row k from ``low`` onwards. Indices
    are unsigned and components separate, or the loop would not be vectorised.
    """
    (i, k, l), (low, p, q, size) = rows, columns
    for c in range(2):
        for j in range(size):
            d1 = u[0, l + 2, j + q + TWO] - u[0, i + 2, j + p + TWO]
            d2 = u[1, l + 2, j + q + TWO] - u[1, i + 2, j + p + TWO]
            s[c, j + p] += G[3 * o + c, k, j + low] * d1 + G[3 * o + c + 1, k, j + low] * d2


@njit
def _row(s, u, i, K):
    """Row i of K u, written to s, shape (2, m)."""
    A, G, (X1, X2) = K.A, K.G, K.axes
    n, m = K.free.shape
    for c in range(2):
        _smoothness(s[c], u[c], i, K.axes, K.bending)
    v1, v2 = u[0, i + 2], u[1, i + 2]
    for j in range(m):
        area = X2[M, i] * X1[M, j]
        s[0, j] += area * (A[0, i, j] * v1[j + 2] + A[1, i, j] * v2[j + 2])
        s[1, j] += area * (A[1, i, j] * v1[j + 2] + A[2, i, j] * v2[j + 2])
    for o in range(G.shape[0] // 3):
        a, b = AHEAD[o]
        p, q, size = np.uintp(max(0, -b)), np.uintp(max(0, b)), np.uintp(m - abs(b))
        if i + a < n:  # the neighbours ahead
            _springs(s, u, G, o, (i, i, i + a), (p, p, q, size))
        if i >= a:  # the neighbours behind
            _springs(s, u, G, o, (i, i - a, i - a), (p, q, p, size))


@njit(fastmath={"reassoc", "contract"})
def _dot(u, q):
    """``u . q`` of a row of a field and one of a functional: the same for any threads."""
    total = 0.0
    for j in range(q.size):
        total += u[j + 2] * q[j]
    return total


@njit
def _product_row(q, u, i, K):
    s = np.empty((2, K.free.shape[1]), u.dtype)
    _row(s, u, i, K)
    zero = u.dtype.type(0)
    for c in range(2):
        for j in range(s.shape[1]):
            q[c, i, j] = s[c, j] if K.free[i, j] else zero
    return _dot(u[0, i + 2], q[0, i]) + _dot(u[1, i + 2], q[1, i])


@compiled
def _product(first, last, q, sums, u, K):
    for i in range(first, last):
        sums[i] = _product_row(q, u, i, K)


def product(q: Real, u: Real, K: Operator) -> Array:
    """Write K u to the functional q; return ``u . K u`` summed over each row, shape (n,)."""
    sums = np.empty(K.shape[0])
    share(_product, K.shape[0], K.free.size, q, sums, u, K)
    return sums


@njit
def _chebyshev_row(y, x, b, i, c1, c2, from_zero, K):
    A, free, (X1, X2) = K.A, K.free, K.axes
    s = np.zeros((2, free.shape[1]), x.dtype)
    if not from_zero:
        _row(s, x, i, K)
    x1, x2, y1, y2 = x[0, i + 2], x[1, i + 2], y[0, i + 2], y[1, i + 2]
    zero = x.dtype.type(0)
    for j in range(free.shape[1]):
        bound = X2[M, i] * X1[S_SUM, j] + X2[S_SUM, i] * X1[M, j] + X2[T_SUM, i] * X1[T_SUM, j]
        area = X2[M, i] * X1[M, j]
        d11, d12, d22 = area * A[0, i, j] + bound, area * A[1, i, j], area * A[2, i, j] + bound
        f = c2 / (d11 * d22 - d12 * d12) if free[i, j] else zero
        r1, r2 = b[0, i, j] - s[0, j], b[1, i, j] - s[1, j]
        z1 = f * (d22 * r1 - d12 * r2)
        z2 = f * (d11 * r2 - d12 * r1)
        if from_zero:
            x1[j + 2], x2[j + 2], y1[j + 2], y2[j + 2] = zero, zero, z1, z2
        else:
            y1[j + 2] = x1[j + 2] + c1 * (x1[j + 2] - y1[j + 2]) + z1
            y2[j + 2] = x2[j + 2] + c1 * (x2[j + 2] - y2[j + 2]) + z2


@compiled
def sweep(first, last, slabs, reach, x, y, b, c, from_zero, K):
    """Steps with the weights c on some slabs, see :func:`eofm.flow.sweeps.smooth`."""
    steps = c.shape[0]
    for slab in range(first, last):
        low, high = slabs[slab, :, 0], slabs[slab, :, 1]
        for front in range(low.min(), high.max() + reach * (steps - 1)):
            for step in range(steps):
                i = front - reach * step
                if low[step] <= i < high[step]:
                    old, new = (x, y) if step % 2 == 0 else (y, x)
                    zero = from_zero and step == 0
                    _chebyshev_row(new, old, b, i, c[step, 0], c[step, 1], zero, K)


@compiled
def _restrict(first, last, rc, b, x, transfer, K):
    (J1, t1), (J2, t2) = transfer
    free, m = K.free, J1.size
    one, zero = b.dtype.type(1), b.dtype.type(0)
    s = np.empty((2, m), b.dtype)
    for strip in range(first, last):
        low, high = strip * STRIP, min((strip + 1) * STRIP, rc.shape[1])
        top = low - 1
        S = np.zeros((2, high - top + 1, m), b.dtype)
        for i in range(np.searchsorted(J2, top), np.searchsorted(J2, high)):
            _row(s, x, i, K)
            k = J2[i] - top
            for c in range(2):
                for j in range(m):
                    r = b[c, i, j] - s[c, j] if free[i, j] else zero
                    S[c, k, j] += (one - t2[i]) * r
                    S[c, k + 1, j] += t2[i] * r
        for c in range(2):
            for i in range(low, high):
                rc[c, i] = 0
                for j in range(m):
                    rc[c, i, J1[j]] += (one - t1[j]) * S[c, i - top, j]
                    rc[c, i, J1[j] + 1] += t1[j] * S[c, i - top, j]


def restrict(rc: Real, b: Real, x: Real, transfer: Transfer, K: Operator) -> None:
    """Write to rc the transpose of the bilinear interpolation of :func:`prolong`, of b - K x."""
    strips = (rc.shape[1] - 1) // STRIP + 1
    share(_restrict, strips, K.free.size, rc, b, x, transfer, K)


@compiled
def _prolong(first, last, x, e, free, transfer):
    (J1, t1), (J2, t2) = transfer
    s = np.empty(e.shape[2], e.dtype)
    one, zero = e.dtype.type(1), e.dtype.type(0)
    for i in range(first, last):
        for c in range(2):
            upper, lower = e[c, J2[i] + 2], e[c, J2[i] + 3]
            for j in range(s.size):
                s[j] = (one - t2[i]) * upper[j] + t2[i] * lower[j]
            for j in range(J1.size):
                v = (one - t1[j]) * s[J1[j] + 2] + t1[j] * s[J1[j] + 3]
                x[c, i + 2, j + 2] += v if free[i, j] else zero


def prolong(x: Real, e: Real, free: Mask, transfer: Transfer) -> None:
    """Add the field e of the coarse grid to the field x on its free nodes."""
    share(_prolong, free.shape[0], free.size, x, e, free, transfer)


@njit(fastmath={"reassoc", "contract"})
def _advance_row(x, r, b, p, q, step, i):
    residual, change = 0.0, 0.0
    for c in range(2):
        for j in range(r.shape[2]):
            d = step * p[c, i + 2, j + 2]
            x[c, i + 2, j + 2] += d
            r[c, i, j] -= step * q[c, i, j]
            b[c, i, j] = r[c, i, j]
            residual += r[c, i, j] ** 2
            change += d * d
    return residual, change


@compiled
def _advance(first, last, sums, iterates, step):
    x, r, b, p, q = iterates
    for i in range(first, last):
        sums[0, i], sums[1, i] = _advance_row(x, r, b, p, q, step, i)


def advance(x: Array, r: Array, b: Real, p: Array, q: Array, step: float) -> Array:
    """``x += step p``, ``r -= step q``, ``b = r``, where b may be r itself.

    Return the squares of r and of the change of x, summed over each row, shape (2, n).
    """
    sums = np.empty((2, r.shape[1]))
    share(_advance, r.shape[1], r.size, sums, (x, r, b, p, q), step)
    return sums


@compiled
def _dots(first, last, sums, z, r):
    for i in range(first, last):
        sums[i] = _dot(z[0, i + 2], r[0, i]) + _dot(z[1, i + 2], r[1, i])


def dot(z: Real, r: Array) -> Array:
    """``z . r`` of a field and a functional, summed over each row, shape (n,)."""
    sums = np.empty(r.shape[1])
    share(_dots, r.shape[1], r.size, sums, z, r)
    return sums


def norm(r: Real) -> float:
    """Euclidean norm of a functional."""
    # Without BLAS, whose sums depend on the number of threads.
    return math.sqrt(np.einsum("cij,cij->", r, r))


@compiled
def _redirect(first, last, p, z, beta):
    for i in range(first, last):
        for c in range(2):
            for j in range(p.shape[2]):
                p[c, i, j] = z[c, i, j] + beta * p[c, i, j]


def redirect(p: Array, z: Real, beta: float) -> None:
    """``p = z + beta p`` for fields."""
    share(_redirect, p.shape[1], p.size, p, z, beta)
