"""Loops over the pixel grid for :mod:`eofm.multigrid`, compiled and parallel over rows.

Two kinds of arrays hold a vector field on a grid of n rows and m columns. *Fields* have
shape (2, n + 4, m + 4): two rows and columns of zeros around the nodes spare the stencils
all questions at the edges. *Functionals* (right-hand sides, ``K u``) have shape (2, n, m).

An operator K is passed as ``A, G, free, X1, X2, bending``:

- ``A``, shape (3, n, m): entries 11, 12, 22 of the 2 x 2 blocks of the pointwise term,
  times area. On coarse grids neighbouring nodes p, q are coupled too, and ``A`` is the
  sum over each row of blocks: the pointwise energy is
  ``sum_p u_p . A_p u_p - sum_pq (u_p - u_q) . G_pq (u_p - u_q)``;
- ``G``, shape (12, n, m): its blocks between a node and the next ones in the directions
  ``AHEAD``; shape (0, n, m) on the finest grid, where there are none;
- ``free``, bool, shape (n, m): False where K u is not wanted;
- ``X1``, shape (11, m), and ``X2``, shape (11, n): the tables of :func:`axis_table`;
- ``bending``: which smoothness the tables are made for.

Every row is computed by one thread, and sums over rows are left to the caller: results
do not depend on the number of threads.
"""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Rows and columns from a node to those of its eight neighbours that come after it.
AHEAD = ((0, 1), (1, -1), (1, 0), (1, 1))
# Nodes below which handing rows to threads costs more than it saves.
SERIAL = 8192
TWO = np.uintp(2)


def axis_table(n: int, h: float, alpha: float, bending: bool) -> Array:
    """Factors along one axis of ``alpha R = M2 x S1 + S2 x M1 + T2 x T1``, shape (11, n).

    Row 0 is the diagonal of M (trapezoidal weights), rows 1 to 5 are the bands -2..2 of S,
    rows 6 to 8 the bands -1..1 of T, rows 9 and 10 the sums of ``|S|`` and ``|T|``.
    S is ``alpha int u' v'`` and T zero for the gradient; for bending S is
    ``alpha int u'' v''`` and T is ``sqrt(2 alpha) int u' v'``.
    """

    def bands(difference: tuple[float, ...]) -> Array:
        order = len(difference) - 1
        S = np.zeros((5, n))
        for p, cp in enumerate(difference):
            for q, cq in enumerate(difference):
                S[2 + q - p, p : n - order + p] += cp * cq * h ** (1 - 2 * order)
        return S

    X = np.zeros((11, n))
    X[0] = h
    X[0, [0, -1]] /= 2
    X[1:6] = alpha * bands((1.0, -2.0, 1.0) if bending else (-1.0, 1.0))
    if bending:
        X[6:9] = np.sqrt(2 * alpha) * bands((-1.0, 1.0))[1:4]
    X[9], X[10] = abs(X[1:6]).sum(0), abs(X[6:9]).sum(0)
    return X


@njit(cache=True)
def _smoothness(s, u, i, X1, X2, bending):
    """Row i of alpha R u for one component: u is (n + 4, m + 4), s is (m,)."""
    ua, ub, uc, ud, ue = u[i], u[i + 1], u[i + 2], u[i + 3], u[i + 4]
    M, Sa, Sb, Sc, Sd, Se = X1[0], X1[1], X1[2], X1[3], X1[4], X1[5]
    Tb, Tc, Td = X1[6], X1[7], X1[8]
    w, sa, sb, sc, sd, se = X2[0, i], X2[1, i], X2[2, i], X2[3, i], X2[4, i], X2[5, i]
    tb, tc, td = X2[6, i], X2[7, i], X2[8, i]
    for j in range(s.size):
        s[j] = w * (Sb[j] * uc[j + 1] + Sc[j] * uc[j + 2] + Sd[j] * uc[j + 3]) + M[j] * (
            sb * ub[j + 2] + sc * uc[j + 2] + sd * ud[j + 2]
        )
    if bending:
        for j in range(s.size):
            s[j] += (
                w * (Sa[j] * uc[j] + Se[j] * uc[j + 4])
                + M[j] * (sa * ua[j + 2] + se * ue[j + 2])
                + Tb[j] * (tb * ub[j + 1] + tc * uc[j + 1] + td * ud[j + 1])
                + Tc[j] * (tb * ub[j + 2] + tc * uc[j + 2] + td * ud[j + 2])
                + Td[j] * (tb * ub[j + 3] + tc * uc[j + 3] + td * ud[j + 3])
            )


@njit(cache=True)
def _springs(s, u, G, o, k, low, i, p, l, q, size):
    """Add ``G (u_q - u_p)`` to s on ``size`` nodes from node p of row i, q of row l onwards.

    The blocks G in direction o belong to the nodes of row k from ``low`` onwards. Indices
    are unsigned and components separate, or the loop would not be vectorised.
    """
    for c in range(2):
        for j in range(size):
            d1 = u[0, l + 2, j + q + TWO] - u[0, i + 2, j + p + TWO]
            d2 = u[1, l + 2, j + q + TWO] - u[1, i + 2, j + p + TWO]
            s[c, j + p] += G[3 * o + c, k, j + low] * d1 + G[3 * o + c + 1, k, j + low] * d2


@njit(cache=True)
def _row(s, u, i, A, G, free, X1, X2, bending):
    """Row i of K u, written to s, shape (2, m)."""
    n, m = free.shape
    for c in range(2):
        _smoothness(s[c], u[c], i, X1, X2, bending)
    v1, v2 = u[0, i + 2], u[1, i + 2]
    for j in range(m):
        s[0, j] += A[0, i, j] * v1[j + 2] + A[1, i, j] * v2[j + 2]
        s[1, j] += A[1, i, j] * v1[j + 2] + A[2, i, j] * v2[j + 2]
    for o in range(G.shape[0] // 3):
        a, b = AHEAD[o]
        p, q, size = np.uintp(max(0, -b)), np.uintp(max(0, b)), np.uintp(m - abs(b))
        if i + a < n:  # the neighbours ahead
            _springs(s, u, G, o, i, p, i, p, i + a, q, size)
        if i >= a:  # the neighbours behind
            _springs(s, u, G, o, i - a, p, i, q, i - a, p, size)


@njit(cache=True)
def _product_row(q, sums, u, i, A, G, free, X1, X2, bending):
    s = np.empty((2, free.shape[1]))
    _row(s, u, i, A, G, free, X1, X2, bending)
    total = 0.0
    for c in range(2):
        for j in range(free.shape[1]):
            q[c, i, j] = s[c, j] * free[i, j]
            total += q[c, i, j] * u[c, i + 2, j + 2]
    sums[i] = total


@njit(cache=True, parallel=True)
def product(q, u, A, G, free, X1, X2, bending):
    """Write K u to the functional q; return ``u . K u`` summed over each row, shape (n,)."""
    n = free.shape[0]
    sums = np.empty(n)
    if free.size < SERIAL:
        for i in range(n):
            _product_row(q, sums, u, i, A, G, free, X1, X2, bending)
    else:
        for i in prange(n):
            _product_row(q, sums, u, i, A, G, free, X1, X2, bending)
    return sums


@njit(cache=True)
def _chebyshev_row(y, x, b, i, c1, c2, A, G, free, X1, X2, bending):
    m = free.shape[1]
    s = np.empty((2, m))
    _row(s, x, i, A, G, free, X1, X2, bending)
    x1, x2, y1, y2 = x[0, i + 2], x[1, i + 2], y[0, i + 2], y[1, i + 2]
    for j in range(m):
        bound = X2[0, i] * X1[9, j] + X2[9, i] * X1[0, j] + X2[10, i] * X1[10, j]
        d11, d12, d22 = A[0, i, j] + bound, A[1, i, j], A[2, i, j] + bound
        f = c2 * free[i, j] / (d11 * d22 - d12 * d12)
        r1, r2 = b[0, i, j] - s[0, j], b[1, i, j] - s[1, j]
        z1, z2 = x1[j + 2], x2[j + 2]
        y1[j + 2] = z1 + c1 * (z1 - y1[j + 2]) + f * (d22 * r1 - d12 * r2)
        y2[j + 2] = z2 + c1 * (z2 - y2[j + 2]) + f * (d11 * r2 - d12 * r1)


@njit(cache=True, parallel=True)
def chebyshev(y, x, b, c1, c2, A, G, free, X1, X2, bending):
    """Overwrite the field y, the iterate before x, by the iterate after it.

    This is ``x + c1 (x - y) + c2 D^-1 (b - K x)``, where D is A plus the sum over each row
    of ``|alpha R|``. Thus K <= D (Gershgorin for R, Jensen for the pointwise term): no
    eigenvalue of D^-1 K exceeds 1.
    """
    if free.size < SERIAL:
        for i in range(free.shape[0]):
            _chebyshev_row(y, x, b, i, c1, c2, A, G, free, X1, X2, bending)
    else:
        for i in prange(free.shape[0]):
            _chebyshev_row(y, x, b, i, c1, c2, A, G, free, X1, X2, bending)


@njit(cache=True)
def _restrict_row(rc, b, q, i, J1, t1, J2, t2):
    m = J1.size
    s = np.zeros((2, m))
    for k in range(np.searchsorted(J2, i - 1), np.searchsorted(J2, i + 1)):
        w = 1 - t2[k] if J2[k] == i else t2[k]
        for c in range(2):
            for j in range(m):
                s[c, j] += w * (b[c, k, j] - q[c, k, j])
    for c in range(2):
        rc[c, i] = 0.0
        for j in range(m):
            rc[c, i, J1[j]] += (1 - t1[j]) * s[c, j]
            rc[c, i, J1[j] + 1] += t1[j] * s[c, j]


@njit(cache=True, parallel=True)
def restrict(rc, b, q, J1, t1, J2, t2):
    """Write to rc the transpose of the bilinear interpolation of :func:`prolong`, of b - q."""
    if b.size < SERIAL:
        for i in range(rc.shape[1]):
            _restrict_row(rc, b, q, i, J1, t1, J2, t2)
    else:
        for i in prange(rc.shape[1]):
            _restrict_row(rc, b, q, i, J1, t1, J2, t2)


@njit(cache=True)
def _prolong_row(x, e, free, i, J1, t1, J2, t2):
    s = np.empty(e.shape[2])
    for c in range(2):
        upper, lower = e[c, J2[i] + 2], e[c, J2[i] + 3]
        for j in range(s.size):
            s[j] = (1 - t2[i]) * upper[j] + t2[i] * lower[j]
        for j in range(J1.size):
            v = (1 - t1[j]) * s[J1[j] + 2] + t1[j] * s[J1[j] + 3]
            x[c, i + 2, j + 2] += v * free[i, j]


@njit(cache=True, parallel=True)
def prolong(x, e, free, J1, t1, J2, t2):
    """Add the field e of the coarse grid to the field x on its free nodes.

    Row i of the fine grid lies between the rows J2[i] and J2[i] + 1 of the coarse one, a
    part t2[i] of their distance from the first; J1 and t1 are the same for columns.
    """
    if free.size < SERIAL:
        for i in range(free.shape[0]):
            _prolong_row(x, e, free, i, J1, t1, J2, t2)
    else:
        for i in prange(free.shape[0]):
            _prolong_row(x, e, free, i, J1, t1, J2, t2)


@njit(cache=True, parallel=True)
def coarsen(T, J, t, nc):
    """Galerkin product ``P^T T P`` along the last axis, moved one axis forward.

    T, shape (K, 3 or 1, n, m), holds K sets of bands -1..1 (or the band 0 alone) along the
    last axis; the result, shape (K, 3, nc, n), those of the nc nodes of the coarse axis. On
    grids that are not nested the product can couple next but one neighbours: we move this
    to the diagonal, which keeps the sums over rows and can only stiffen the energy.
    """
    K, bands, n, m = T.shape
    out = np.empty((K, 3, nc, n))
    for i in prange(n):
        for k in range(K):
            s = np.zeros((5, nc))  # bands -2..2
            for b in range(bands):
                shift = b - bands // 2
                for j in range(max(0, -shift), m - max(0, shift)):
                    v, p, q = T[k, b, i, j], t[j], t[j + shift]
                    d = 2 + J[j + shift] - J[j]
                    s[d, J[j]] += (1 - p) * (1 - q) * v
                    s[d + 1, J[j]] += (1 - p) * q * v
                    s[d - 1, J[j] + 1] += p * (1 - q) * v
                    s[d, J[j] + 1] += p * q * v
            s[2] += s[0] + s[4]
            out[k, :, :, i] = s[1:4]
    return out


@njit(cache=True, parallel=True)
def advance(x, r, p, q, step):
    """``x += step p``, ``r -= step q``; return ``r . r`` summed over each row."""
    n, m = r.shape[1:]
    sums = np.empty(n)
    for i in prange(n):
        total = 0.0
        for c in range(2):
            for j in range(m):
                x[c, i + 2, j + 2] += step * p[c, i + 2, j + 2]
                r[c, i, j] -= step * q[c, i, j]
                total += r[c, i, j] ** 2
        sums[i] = total
    return sums


@njit(cache=True, parallel=True)
def dot(z, r):
    """``z . r`` of a field and a functional, summed over each row, shape (n,)."""
    n, m = r.shape[1:]
    sums = np.empty(n)
    for i in prange(n):
        total = 0.0
        for c in range(2):
            for j in range(m):
                total += z[c, i + 2, j + 2] * r[c, i, j]
        sums[i] = total
    return sums


@njit(cache=True, parallel=True)
def redirect(p, z, beta):
    """``p = z + beta p`` for fields."""
    for i in prange(p.shape[1]):
        for c in range(2):
            for j in range(p.shape[2]):
                p[c, i, j] = z[c, i, j] + beta * p[c, i, j]
