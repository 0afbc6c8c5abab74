"""Loops over the pixel grid for :mod:`eofm.flow.multigrid`, compiled and parallel over rows.

Two kinds of arrays hold a vector field on a grid of n rows and m columns. *Fields* have
shape (2, n + 4, m + 4): two rows and columns of zeros around the nodes spare the stencils
all questions at the edges. *Functionals* (right-hand sides, ``K u``) have shape (2, n, m).

An operator K is passed as ``A, G, free, X1, X2, bending``:

- ``A``, shape (3, n, m): entries 11, 12, 22 of the 2 x 2 blocks of the pointwise term, per
  area a_p of a node p. On coarse grids neighbouring nodes p, q may be coupled too, and
  ``a_p A_p`` is the sum over each row of blocks: the pointwise energy is
  ``sum_p a_p u_p . A_p u_p - sum_pq (u_p - u_q) . G_pq (u_p - u_q)``;
- ``G``, shape (12, n, m): its blocks between a node and the next ones in the directions
  ``AHEAD``; shape (0, n, m) where there are none, as on the finest grid;
- ``free``, bool, shape (n, m): False where K u is not wanted;
- ``X1``, shape (11, m), and ``X2``, shape (11, n): the tables of :func:`axis_table`;
- ``bending``: which smoothness the tables are made for.

All arrays may have single or double precision, those of one call the same one.

Every row is computed by one thread, and sums over rows are left to the caller: results
do not depend on the number of threads.
"""

import numpy as np
from numba import njit, prange

from eofm.grid import Array

# Rows and columns from a node to those of its eight neighbours that come after it.
AHEAD = ((0, 1), (1, -1), (1, 0), (1, 1))
# Rows of a coarse grid that one thread makes together.
STRIP = 16
# Nodes below which handing rows to threads costs more than it saves.
SERIAL = 2**16
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
        area = X2[0, i] * X1[0, j]
        s[0, j] += area * (A[0, i, j] * v1[j + 2] + A[1, i, j] * v2[j + 2])
        s[1, j] += area * (A[1, i, j] * v1[j + 2] + A[2, i, j] * v2[j + 2])
    for o in range(G.shape[0] // 3):
        a, b = AHEAD[o]
        p, q, size = np.uintp(max(0, -b)), np.uintp(max(0, b)), np.uintp(m - abs(b))
        if i + a < n:  # the neighbours ahead
            _springs(s, u, G, o, i, p, i, p, i + a, q, size)
        if i >= a:  # the neighbours behind
            _springs(s, u, G, o, i - a, p, i, q, i - a, p, size)


@njit(cache=True, fastmath={"reassoc", "contract"})
def _dot(u, q):
    """``u . q`` of a row of a field and one of a functional: the same for any threads."""
    total = 0.0
    for j in range(q.size):
        total += u[j + 2] * q[j]
    return total


@njit(cache=True)
def _product_row(q, sums, u, i, A, G, free, X1, X2, bending):
    s = np.empty((2, free.shape[1]), u.dtype)
    _row(s, u, i, A, G, free, X1, X2, bending)
    zero = u.dtype.type(0)
    for c in range(2):
        for j in range(free.shape[1]):
            q[c, i, j] = s[c, j] if free[i, j] else zero
    sums[i] = _dot(u[0, i + 2], q[0, i]) + _dot(u[1, i + 2], q[1, i])


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
def _chebyshev_row(y, x, b, i, c1, c2, first, A, G, free, X1, X2, bending):
    m = free.shape[1]
    s = np.zeros((2, m), x.dtype)
    if not first:
        _row(s, x, i, A, G, free, X1, X2, bending)
    x1, x2, y1, y2 = x[0, i + 2], x[1, i + 2], y[0, i + 2], y[1, i + 2]
    zero = x.dtype.type(0)
    for j in range(m):
        bound = X2[0, i] * X1[9, j] + X2[9, i] * X1[0, j] + X2[10, i] * X1[10, j]
        area = X2[0, i] * X1[0, j]
        d11, d12, d22 = area * A[0, i, j] + bound, area * A[1, i, j], area * A[2, i, j] + bound
        f = c2 / (d11 * d22 - d12 * d12) if free[i, j] else zero
        r1, r2 = b[0, i, j] - s[0, j], b[1, i, j] - s[1, j]
        z1 = f * (d22 * r1 - d12 * r2)
        z2 = f * (d11 * r2 - d12 * r1)
        if first:
            x1[j + 2], x2[j + 2], y1[j + 2], y2[j + 2] = zero, zero, z1, z2
        else:
            y1[j + 2] = x1[j + 2] + c1 * (x1[j + 2] - y1[j + 2]) + z1
            y2[j + 2] = x2[j + 2] + c1 * (x2[j + 2] - y2[j + 2]) + z2


@njit(cache=True, parallel=True)
def chebyshev(y, x, b, c1, c2, first, A, G, free, X1, X2, bending):
    """Overwrite the field y, the iterate before x, by the iterate after it.

    This is ``x + c1 (x - y) + c2 D^-1 (b - K x)``, where D is A plus the sum over each row
    of ``|alpha R|``. Thus K <= D (Gershgorin for R, Jensen for the pointwise term): no
    eigenvalue of D^-1 K exceeds 1. The first step makes x zero.
    """
    if free.size < SERIAL:
        for i in range(free.shape[0]):
            _chebyshev_row(y, x, b, i, c1, c2, first, A, G, free, X1, X2, bending)
    else:
        for i in prange(free.shape[0]):
            _chebyshev_row(y, x, b, i, c1, c2, first, A, G, free, X1, X2, bending)


@njit(cache=True)
def _restrict_strip(rc, low, b, x, J1, t1, J2, t2, A, G, free, X1, X2, bending):
    m = J1.size
    high = min(low + STRIP, rc.shape[1])
    top = low - 1
    S = np.zeros((2, high - top + 1, m), b.dtype)
    s = np.empty((2, m), b.dtype)
    one, zero = b.dtype.type(1), b.dtype.type(0)
    for i in range(np.searchsorted(J2, top), np.searchsorted(J2, high)):
        _row(s, x, i, A, G, free, X1, X2, bending)
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


@njit(cache=True, parallel=True)
def restrict(rc, b, x, J1, t1, J2, t2, A, G, free, X1, X2, bending):
    """Write to rc the transpose of the bilinear interpolation of :func:`prolong`, of b - K x."""
    strips = (rc.shape[1] - 1) // STRIP + 1
    if free.size < SERIAL:
        for k in range(strips):
            _restrict_strip(rc, k * STRIP, b, x, J1, t1, J2, t2, A, G, free, X1, X2, bending)
    else:
        for k in prange(strips):
            _restrict_strip(rc, k * STRIP, b, x, J1, t1, J2, t2, A, G, free, X1, X2, bending)


@njit(cache=True)
def _prolong_row(x, e, free, i, J1, t1, J2, t2):
    s = np.empty(e.shape[2], e.dtype)
    one, zero = e.dtype.type(1), e.dtype.type(0)
    for c in range(2):
        upper, lower = e[c, J2[i] + 2], e[c, J2[i] + 3]
        for j in range(s.size):
            s[j] = (one - t2[i]) * upper[j] + t2[i] * lower[j]
        for j in range(J1.size):
            v = (one - t1[j]) * s[J1[j] + 2] + t1[j] * s[J1[j] + 3]
            x[c, i + 2, j + 2] += v if free[i, j] else zero


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


@njit(cache=True)
def _share(S, c, i, j, w, a):
    """Share entry c of the term A of a node among the corners of its cell, by their weights."""
    S[c, i, j] += w[0] * a
    S[c, i, j + 1] += w[1] * a
    S[c, i + 1, j] += w[2] * a
    S[c, i + 1, j + 1] += w[3] * a


@njit(cache=True)
def _couple(S, c, i, j, w, a):
    """Couple the corners (i, j) to (i + 1, j + 1) of a cell by the products of their weights.

    If the sum of the weights w is 1, ``(sum_k w_k u_k) . A (sum_k w_k u_k)`` is
    ``sum_k w_k u_k . A u_k - sum_kl w_k w_l (u_k - u_l) . A (u_k - u_l)``, and if it is 0,
    the last sum alone. c is the entry of A.
    """
    p, q, r, s = w
    S[3 + c, i, j] += p * q * a
    S[3 + c, i + 1, j] += r * s * a
    S[6 + c, i, j + 1] += q * r * a
    S[9 + c, i, j] += p * r * a
    S[9 + c, i, j + 1] += q * s * a
    S[12 + c, i, j] += p * s * a


@njit(cache=True)
def _share_spring(S, i, j, p1, p2, q1, q2, g11, g12, g22):
    """Share the term G of two nodes, with weights p and q, among 3 x 3 coarse ones."""
    for k in range(3):
        for l in range(3):
            d = p2[k] * p1[l] - q2[k] * q1[l]
            if d == 0:
                continue
            for o in range(4):
                a, b = AHEAD[o]
                if k + a > 2 or l + b > 2 or l + b < 0:
                    continue
                f = -d * (p2[k + a] * p1[l + b] - q2[k + a] * q1[l + b])
                S[3 + 3 * o, i + k, j + l] += f * g11
                S[4 + 3 * o, i + k, j + l] += f * g12
                S[5 + 3 * o, i + k, j + l] += f * g22


@njit(cache=True)
def _around(J, t, start):
    """Weights of the three coarse nodes from ``start`` on."""
    return (1 - t, t, 0.0) if start == J else (0.0, 1 - t, t)


@njit(cache=True)
def _coarsen_strip(Ac, Gc, low, A, G, free, X1, X2, J1, t1, J2, t2):
    n, m = free.shape
    nc, mc = Ac.shape[1:]
    high = min(low + STRIP, nc)
    top = low - 2
    S = np.zeros((3 + Gc.shape[0], high - top + 2, mc + 1))
    for i in range(np.searchsorted(J2, top), np.searchsorted(J2, high)):
        I = J2[i] - top
        for j in range(m):
            if free[i, j]:
                f = X2[0, i] * X1[0, j]
                a11, a12, a22 = f * A[0, i, j], f * A[1, i, j], f * A[2, i, j]
            else:
                f = X2[0, i] * X1[3, j] + X2[3, i] * X1[0, j] + X2[7, i] * X1[7, j]
                a11, a12, a22 = f, 0.0, f
            p, q = 1 - t1[j], t1[j]
            w = (1 - t2[i]) * p, (1 - t2[i]) * q, t2[i] * p, t2[i] * q
            _share(S, 0, I, J1[j], w, a11)
            _share(S, 1, I, J1[j], w, a12)
            _share(S, 2, I, J1[j], w, a22)
            if Gc.shape[0]:
                _couple(S, 0, I, J1[j], w, a11)
                _couple(S, 1, I, J1[j], w, a12)
                _couple(S, 2, I, J1[j], w, a22)
        for o in range(G.shape[0] // 3):
            a, b = AHEAD[o]
            if i + a == n:
                continue
            p2, q2 = _around(J2[i], t2[i], J2[i]), _around(J2[i + a], t2[i + a], J2[i])
            for j in range(max(0, -b), m - max(0, b)):
                J = min(J1[j], J1[j + b])
                p1, q1 = _around(J1[j], t1[j], J), _around(J1[j + b], t1[j + b], J)
                g11, g12, g22 = G[3 * o, i, j], G[3 * o + 1, i, j], G[3 * o + 2, i, j]
                if q2[2] == 0 and p1[2] == 0 and q1[2] == 0:  # in one cell
                    upper = p2[0] * p1[0] - q2[0] * q1[0], p2[0] * p1[1] - q2[0] * q1[1]
                    lower = p2[1] * p1[0] - q2[1] * q1[0], p2[1] * p1[1] - q2[1] * q1[1]
                    d = (*upper, *lower)
                    _couple(S, 0, I, J, d, -g11)
                    _couple(S, 1, I, J, d, -g12)
                    _couple(S, 2, I, J, d, -g22)
                else:
                    _share_spring(S, I, J, p1, p2, q1, q2, g11, g12, g22)
    S = S[:, low - top : high - top, :mc]
    Ac[:, low:high] = S[:3]
    Gc[:, low:high] = S[3:]


@njit(cache=True, parallel=True)
def coarsen(Ac, Gc, A, G, free, X1, X2, J1, t1, J2, t2):
    """Write the Galerkin product of the pointwise term with bilinear interpolation.

    ``Ac`` is not divided by area yet. Nodes that are not free are as stiff as the smoothness
    term. An empty ``Gc``, for an empty ``G``, leaves couplings out. On grids that are not nested
    the product can couple next but one neighbours: we leave these out, which keeps the sums over
    rows and can only stiffen the energy.
    """
    strips = (Ac.shape[1] - 1) // STRIP + 1
    if free.size < SERIAL:
        for k in range(strips):
            _coarsen_strip(Ac, Gc, k * STRIP, A, G, free, X1, X2, J1, t1, J2, t2)
    else:
        for k in prange(strips):
            _coarsen_strip(Ac, Gc, k * STRIP, A, G, free, X1, X2, J1, t1, J2, t2)


@njit(cache=True, fastmath={"reassoc", "contract"})
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


@njit(cache=True, parallel=True)
def advance(x, r, b, p, q, step):
    """``x += step p``, ``r -= step q``, ``b = r``, where b may be r itself.

    Return the squares of r and of the change of x, summed over each row, shape (2, n).
    """
    sums = np.empty((2, r.shape[1]))
    if r.size < SERIAL:
        for i in range(r.shape[1]):
            sums[0, i], sums[1, i] = _advance_row(x, r, b, p, q, step, i)
    else:
        for i in prange(r.shape[1]):
            sums[0, i], sums[1, i] = _advance_row(x, r, b, p, q, step, i)
    return sums


@njit(cache=True, parallel=True)
def dot(z, r):
    """``z . r`` of a field and a functional, summed over each row, shape (n,)."""
    sums = np.empty(r.shape[1])
    if r.size < SERIAL:
        for i in range(r.shape[1]):
            sums[i] = _dot(z[0, i + 2], r[0, i]) + _dot(z[1, i + 2], r[1, i])
    else:
        for i in prange(r.shape[1]):
            sums[i] = _dot(z[0, i + 2], r[0, i]) + _dot(z[1, i + 2], r[1, i])
    return sums


@njit(cache=True)
def _redirect_row(p, z, beta, i):
    for c in range(2):
        for j in range(p.shape[2]):
            p[c, i, j] = z[c, i, j] + beta * p[c, i, j]


@njit(cache=True, parallel=True)
def redirect(p, z, beta):
    """``p = z + beta p`` for fields."""
    if p.size < SERIAL:
        for i in range(p.shape[1]):
            _redirect_row(p, z, beta, i)
    else:
        for i in prange(p.shape[1]):
            _redirect_row(p, z, beta, i)
