"""The pointwise term of :mod:`eofm.flow.stencils3` on a coarser grid, one axis after the other.

Along one axis the sum ``sum_i r_i u_i^2 - sum_i o_i (u_i - u_i+1)^2`` over nodes becomes, if u is
interpolated linearly between coarse nodes, one of the same kind. The pointwise term of a volume
is such a sum along each axis: eight kinds of coefficients, r or o for each, which are the
symmetric matrices of one node, of the four between neighbours and so on. All kinds are made
from those of the fine grid in three sweeps, one for each axis.
"""

import numpy as np
from numba import njit

from eofm.compiled import compiled, share
from eofm.flow.operator import SC, TC, M, Operator, Real, Transfer
from eofm.flow.stencils3 import STRIP

# Numbers of a symmetric matrix.
ENTRIES = 6


@njit
def _own(a, k, i, K):
    """The matrices A of a row times their volumes, stiff ones where not free."""
    X1, X2, X3 = K.axes
    area = X3[M, k] * X2[M, i]
    f2 = X3[M, k] * X2[SC, i] + X3[SC, k] * X2[M, i] + X3[TC, k] * X2[TC, i]
    t2 = X3[M, k] * X2[TC, i] + X3[TC, k] * X2[M, i]
    free = K.free[k, i]
    for c in range(ENTRIES):
        for j in range(free.size):
            if free[j]:
                a[c, j] = area * X1[M, j] * K.A[c, k, i, j]
            elif c == 0 or c == 3 or c == 5:
                a[c, j] = f2 * X1[M, j] + area * X1[SC, j] + t2 * X1[TC, j]
            else:
                a[c, j] = 0


@njit
def _nodes(r, o, a, J1, t1, couple):
    """Add r of a line to r and, to couple, o of the coarse one."""
    for j in range(a.size):
        t, J = t1[j], J1[j]
        r[J] += (1 - t) * a[j]
        r[J + 1] += t * a[j]
        if couple:
            o[J] += t * (1 - t) * a[j]


@njit
def _weights(J, t, i):
    """Those of o of the nodes i and i + 1 in o of the coarse nodes J[i] and J[i] + 1."""
    if i + 1 == J.size:
        return t[i] - t[i], t[i] - t[i]
    if J[i + 1] == J[i]:
        return (t[i + 1] - t[i]) ** 2, t[i] - t[i]
    middle = 1 - t[i] - t[i + 1]
    return (1 - t[i]) * middle, -t[i + 1] * middle


@njit
def _springs(o, a, J1, t1):
    """Add o of a line to o of the coarse one."""
    for j in range(a.size - 1):
        here, ahead = _weights(J1, t1, j)
        o[J1[j]] += here * a[j]
        o[J1[j] + 1] += ahead * a[j]


@njit
def _add(s, a, f):
    for j in range(s.size):
        s[j] += f * a[j]


@njit
def _across(P, kind, a, I, t, here, ahead, couple):
    """Add a line of a kind along the second or third axis to those of the coarse lines I, I + 1."""
    if kind == 0:
        _add(P[0, I], a, 1 - t)
        _add(P[0, I + 1], a, t)
        if couple:
            _add(P[1, I], a, t * (1 - t))
    else:
        _add(P[1, I], a, here)
        _add(P[1, I + 1], a, ahead)


@njit
def _slice(P, L, a, X, k, K, transfer, couple):
    """Sum up slice k along the first two axes in P, shape (o or r, ..., entries, rows, columns)."""
    (J1, t1), (J2, t2), _ = transfer
    n, kinds = J2.size, 8 if X.shape[0] > 0 else 1
    for i in range(n):
        here, ahead = _weights(J2, t2, i)
        for kind in range(0, kinds, 2):
            b3, b2 = kind >> 2, kind >> 1 & 1
            if kind == 0:
                _own(a, k, i, K)
            for c in range(ENTRIES):
                L[:] = 0
                line = a[c] if kind == 0 else X[ENTRIES * (kind - 1) + c, k, i]
                _nodes(L[0], L[1], line, J1, t1, couple)
                if kinds > 1:
                    _springs(L[1], X[ENTRIES * kind + c, k, i], J1, t1)
                for b1 in range(2 if couple else 1):
                    _across(P[b3, b1, c], b2, L[b1], J2[i], t2[i], here, ahead, couple)


@njit
def _collect(Ac, Xc, P, low, high, I, t, here, ahead, X):
    """Add the sums of a slice to those of the coarse slices I and I + 1 from low to high - 1."""
    couple = Xc.shape[0] > 0
    for b3 in range(2 if X.shape[0] > 0 else 1):
        for b1 in range(2 if couple else 1):
            for c in range(ENTRIES):
                for b2 in range(2 if couple else 1):
                    kind = 2 * b2 + b1
                    for n in range(Ac.shape[2]):
                        a = P[b3, b1, c, b2, n]
                        for up in range(2):
                            if not low <= I + up < high:
                                continue
                            if b3 == 0:
                                f = t if up else 1 - t
                                if kind == 0:
                                    _add(Ac[c, I + up, n], a, f)
                                else:
                                    _add(Xc[ENTRIES * (kind - 1) + c, I + up, n], a, f)
                            if couple:
                                f = (ahead if up else here) if b3 else (t * (1 - t) * (1 - up))
                                _add(Xc[ENTRIES * (kind + 3) + c, I + up, n], a, f)


@compiled
def _coarsen(first, last, Ac, Xc, X, K, transfer):
    J3, t3 = transfer[2]
    lc, nc, mc = Ac.shape[1:]
    couple = Xc.shape[0] > 0
    P = np.empty((2, 2, ENTRIES, 2, nc + 1, mc + 1), Ac.dtype)
    L, a = np.empty((2, mc + 1), Ac.dtype), np.empty((ENTRIES, K.free.shape[2]), Ac.dtype)
    for strip in range(first, last):
        low, high = strip * STRIP, min((strip + 1) * STRIP, lc)
        Ac[:, low:high], Xc[:, low:high] = 0, 0
        for k in range(np.searchsorted(J3, low - 1), np.searchsorted(J3, high)):
            P[:] = 0
            _slice(P, L, a, X, k, K, transfer, couple)
            here, ahead = _weights(J3, t3, k)
            _collect(Ac, Xc, P, low, high, J3[k], t3[k], here, ahead, X)


def coarsen(Ac: Real, Gc: Real, K: Operator, transfer: Transfer) -> None:
    """Write the Galerkin product of the pointwise term with trilinear interpolation.

    See :func:`eofm.flow.galerkin.coarsen`.
    """
    strips = (Ac.shape[1] - 1) // STRIP + 1
    X = _along_axes(K.G.copy(), 1)
    share(_coarsen, strips, 3 * K.free.size, Ac, Gc, X, K, transfer)
    _along_axes(Gc, -1)


def _along_axes(G: Real, sign: int) -> Real:
    """Turn couplings of pairs of nodes in place into coefficients of their kind, or back.

    A coupling along some axes holds for all pairs that lie so, and the coefficient is its sum
    over the neighbours across. ``G`` has shape (42, l, n, m).
    """
    kinds = G.reshape(-1, ENTRIES, *G.shape[1:])
    for axis in range(3 if len(kinds) else 0):
        for kind in range(1, 8):
            if not kind >> axis & 1:
                other = kinds[(kind | 1 << axis) - 1]
                kinds[kind - 1] += sign * other
                ahead, before = [slice(None)] * 4, [slice(None)] * 4
                ahead[3 - axis], before[3 - axis] = slice(1, None), slice(None, -1)
                kinds[kind - 1][tuple(ahead)] += sign * other[tuple(before)]
    return G
