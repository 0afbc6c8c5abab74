"""The pointwise term of :mod:`eofm.flow.stencils` on a coarser grid, shared by strips.

A strip of :data:`eofm.flow.stencils.STRIP` coarse rows is summed up from the fine nodes around it,
so that no two threads add to the same row.
"""

import numpy as np
from numba import njit

from eofm.compiled import compiled, share
from eofm.flow.operator import SC, TC, M, Operator, Real, Transfer
from eofm.flow.stencils import AHEAD, STRIP


@njit
def _share(S, c, i, j, w, a):
    """Share entry c of the term A of a node among the corners of its cell, by their weights."""
    S[c, i, j] += w[0] * a
    S[c, i, j + 1] += w[1] * a
    S[c, i + 1, j] += w[2] * a
    S[c, i + 1, j + 1] += w[3] * a


@njit
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


@njit
def _share_spring(S, i, j, p, q, g):
    """Share the block g of two nodes, with weights p and q, among 3 x 3 coarse ones."""
    (p1, p2), (q1, q2) = p, q
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
                S[3 + 3 * o, i + k, j + l] += f * g[0]
                S[4 + 3 * o, i + k, j + l] += f * g[1]
                S[5 + 3 * o, i + k, j + l] += f * g[2]


@njit
def _around(J, t, start):
    """Weights of the three coarse nodes from ``start`` on."""
    return (1 - t, t, 0.0) if start == J else (0.0, 1 - t, t)


@njit
def _add_nodes(S, top, i, coupled, K, transfer):
    """Add the blocks A of row i to the sums of a strip that begins at a coarse row."""
    A, (X1, X2) = K.A, K.axes
    (J1, t1), (J2, t2) = transfer
    I = J2[i] - top
    for j in range(J1.size):
        if K.free[i, j]:
            f = X2[M, i] * X1[M, j]
            a11, a12, a22 = f * A[0, i, j], f * A[1, i, j], f * A[2, i, j]
        else:
            f = X2[M, i] * X1[SC, j] + X2[SC, i] * X1[M, j] + X2[TC, i] * X1[TC, j]
            a11, a12, a22 = f, 0.0, f
        p, q = 1 - t1[j], t1[j]
        w = (1 - t2[i]) * p, (1 - t2[i]) * q, t2[i] * p, t2[i] * q
        _share(S, 0, I, J1[j], w, a11)
        _share(S, 1, I, J1[j], w, a12)
        _share(S, 2, I, J1[j], w, a22)
        if coupled:
            _couple(S, 0, I, J1[j], w, a11)
            _couple(S, 1, I, J1[j], w, a12)
            _couple(S, 2, I, J1[j], w, a22)


@njit
def _add_springs(S, top, i, o, K, transfer):
    """Add the blocks G of row i in direction o."""
    G = K.G
    (J1, t1), (J2, t2) = transfer
    I = J2[i] - top
    a, b = AHEAD[o]
    p2, q2 = _around(J2[i], t2[i], J2[i]), _around(J2[i + a], t2[i + a], J2[i])
    for j in range(max(0, -b), J1.size - max(0, b)):
        J = min(J1[j], J1[j + b])
        p1, q1 = _around(J1[j], t1[j], J), _around(J1[j + b], t1[j + b], J)
        g = G[3 * o, i, j], G[3 * o + 1, i, j], G[3 * o + 2, i, j]
        if q2[2] == 0 and p1[2] == 0 and q1[2] == 0:  # in one cell
            upper = p2[0] * p1[0] - q2[0] * q1[0], p2[0] * p1[1] - q2[0] * q1[1]
            lower = p2[1] * p1[0] - q2[1] * q1[0], p2[1] * p1[1] - q2[1] * q1[1]
            d = (*upper, *lower)
            _couple(S, 0, I, J, d, -g[0])
            _couple(S, 1, I, J, d, -g[1])
            _couple(S, 2, I, J, d, -g[2])
        else:
            _share_spring(S, I, J, (p1, p2), (q1, q2), g)


@compiled
def _coarsen(first, last, Ac, Gc, K, transfer):
    J2 = transfer[1].J
    nc, mc = Ac.shape[1:]
    for strip in range(first, last):
        low, high = strip * STRIP, min((strip + 1) * STRIP, nc)
        top = low - 2
        S = np.zeros((3 + Gc.shape[0], high - top + 2, mc + 1))
        for i in range(np.searchsorted(J2, top), np.searchsorted(J2, high)):
            _add_nodes(S, top, i, Gc.shape[0] > 0, K, transfer)
            for o in range(K.G.shape[0] // 3):
                if i + AHEAD[o][0] < J2.size:
                    _add_springs(S, top, i, o, K, transfer)
        for i in range(low, high):
            for c in range(3):
                for j in range(mc):
                    Ac[c, i, j] = S[c, i - top, j]
            for c in range(Gc.shape[0]):
                for j in range(mc):
                    Gc[c, i, j] = S[3 + c, i - top, j]


def coarsen(Ac: Real, Gc: Real, K: Operator, transfer: Transfer) -> None:
    """Write the Galerkin product of the pointwise term with bilinear interpolation.

    ``Ac`` is not divided by area yet. Nodes that are not free are as stiff as the smoothness
    term. An empty ``Gc``, for an empty ``G``, leaves couplings out. On grids that are not nested
    the product can couple next but one neighbours: we leave these out, which keeps the sums over
    rows and can only stiffen the energy.
    """
    strips = (Ac.shape[1] - 1) // STRIP + 1
    share(_coarsen, strips, K.free.size, Ac, Gc, K, transfer)
