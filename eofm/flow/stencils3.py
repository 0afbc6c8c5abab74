"""Loops over the voxel grid for :mod:`eofm.flow.multigrid`: :mod:`eofm.flow.stencils` for volumes.

*Fields* on a grid of l slices, n rows and m columns have shape (3, l + 4, n + 4, m + 4), with two
zeros around the nodes on all sides; *functionals* have shape (3, l, n, m), or that of fields,
whose border they leave alone, where a loop says so.

A *block* is what is computed together: some columns of a long row, or some short rows, whose fields
are one line from the first node to the last, with what lies around the volume between them. So
loops are long enough to be worth their start. They go in steps that each read few arrays and write
into one: the lines of one array ``w``. So compilers vectorise all of them.
"""

import math
from typing import NamedTuple

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

# Numbers of a block, and lines of w. Three each, with the same distance for all components: K u
# and u. Two, of one component, that it is made of. One each: the volume of a node and the bound of
# the smoothness term.
WIDE = 512
LINE = WIDE + 16
ACROSS, V, VOLUME, BOUND, LINES = 3, 5, 8, 9, 10
# Lines of a block and of the rows around it, of three components of three slices.
NEAR = 3 * LINE
# Rows of a strip in which steps of the smoother go through a volume.
ROWS = 32
# Slices of a coarse grid that are made together.
STRIP = 8
FAST = {"contract"}


class Block(NamedTuple):
    """Columns j to e - 1 of rows i to i + rows - 1 of slice k: all columns, of several rows."""

    k: int
    i: int
    j: int
    e: int
    rows: int


@njit
def _blocks(i, last, shape):
    """Rows from i on that are a block, and its columns: inner rows have the same factors."""
    n, m = shape[1:]
    alike = min(last, n - 2) - i if i >= 2 else 1
    return max(1, min(alike, LINE // (m + 4))), min(m, WIDE)


@njit
def _at(c, block, shape):
    """Where the first node of a block stands in a field that is one line."""
    l, n, m = shape
    return ((c * (l + 4) + block.k + 2) * (n + 4) + block.i + 2) * (m + 4) + block.j + 2


@njit
def _from(c, block, shape):
    """The same in a functional, in A, or in what is free."""
    l, n, m = shape
    return ((c * l + block.k) * n + block.i) * m + block.j


@njit(fastmath=FAST)
def _rows(s, rows, f, g, size, bending):
    """Sums of five rows, times factors f and, for bending, times g on the next line."""
    r0, r1, r2, r3, r4 = rows
    f0, f1, f2, f3, f4 = f
    g0, g1, g2, g3, g4 = g
    if bending:
        for x in range(size):
            v0, v1, v2, v3, v4 = r0[x], r1[x], r2[x], r3[x], r4[x]
            s[x] = f0 * v0 + (f1 * v1 + f2 * v2) + (f3 * v3 + f4 * v4)
            s[LINE + x] = g0 * v0 + (g1 * v1 + g2 * v2) + (g3 * v3 + g4 * v4)
    else:
        for x in range(size):
            s[x] = f0 * r0[x] + (f1 * r1[x] + f2 * r2[x]) + (f3 * r3[x] + f4 * r4[x])


@njit(fastmath=FAST)
def _more_rows(s, near, far, f, g, size):
    """Add four rows and four others, times factors."""
    (p0, p1, p2, p3), (q0, q1, q2, q3) = near, far
    (f0, f1, f2, f3), (g0, g1, g2, g3) = f, g
    for x in range(size):
        s[x] += ((f0 * p0[x] + f1 * p1[x]) + (f2 * p2[x] + f3 * p3[x])) + (
            (g0 * q0[x] + g1 * q1[x]) + (g2 * q2[x] + g3 * q3[x])
        )


@njit(fastmath=FAST)
def _along(out, s, u, X, j, w, size, bending):
    """``m s + T t + w S u`` in columns that are all like column j of X.

    t is the line after s, u begins two columns before ``out`` and both s and t one column.
    """
    m, sa, sb, sc, sd, se = (
        X[M, j],
        w * X[SA, j],
        w * X[SB, j],
        w * X[SC, j],
        w * X[SD, j],
        w * X[SE, j],
    )
    tb, tc, td = X[TB, j], X[TC, j], X[TD, j]
    if bending:
        for x in range(size):
            t = LINE + x
            out[x] = (
                (m * s[x + 1] + sc * u[x + 2] + tc * s[t + 1])
                + (sb * u[x + 1] + sd * u[x + 3])
                + (sa * u[x] + se * u[x + 4])
                + (tb * s[t] + td * s[t + 2])
            )
    else:
        for x in range(size):
            out[x] = m * s[x + 1] + (sc * u[x + 2] + (sb * u[x + 1] + sd * u[x + 3]))


@njit(fastmath=FAST)
def _ends(out, s, u, X, j, w, first, last, bending):
    """The same in columns of which each has a column of X, from column j on."""
    for x in range(first, last):
        y, t = j + x, LINE + x
        total = X[M, y] * s[x + 1]
        total += w * (X[SC, y] * u[x + 2] + (X[SB, y] * u[x + 1] + X[SD, y] * u[x + 3]))
        if bending:
            total += w * (X[SA, y] * u[x] + X[SE, y] * u[x + 4])
            total += X[TC, y] * s[t + 1] + (X[TB, y] * s[t] + X[TD, y] * s[t + 2])
        out[x] = total


@njit(fastmath=FAST)
def _smoothness(w, c, u, block, K):
    """Component c of alpha R u in a block, and u to line V."""
    k, i, j, e, rows = block
    X1, X2, X3 = K.axes
    n, m = K.free.shape[1:]
    size, o, bending = e - j, _at(c, block, K.free.shape), K.bending
    row = m + 4
    slice_ = row * (n + 4)
    w3, sa3, sb3, sc3, sd3, se3 = X3[M, k], X3[SA, k], X3[SB, k], X3[SC, k], X3[SD, k], X3[SE, k]
    w2, sa2, sb2, sc2, sd2, se2 = X2[M, i], X2[SA, i], X2[SB, i], X2[SC, i], X2[SD, i], X2[SE, i]
    tb3, tc3, td3, tb2, tc2, td2 = X3[TB, k], X3[TC, k], X3[TD, k], X2[TB, i], X2[TC, i], X2[TD, i]
    s, a, length = w[ACROSS * LINE :], o - 1, (rows - 1) * row + size + 2
    _rows(
        s,
        (u[a:], u[a - row :], u[a + row :], u[a - slice_ :], u[a + slice_ :]),
        (
            w3 * sc2 + w2 * sc3 + tc3 * tc2,
            w3 * sb2 + tc3 * tb2,
            w3 * sd2 + tc3 * td2,
            w2 * sb3 + tb3 * tc2,
            w2 * sd3 + td3 * tc2,
        ),
        (w3 * tc2 + w2 * tc3, w3 * tb2, w3 * td2, w2 * tb3, w2 * td3),
        length,
        bending,
    )
    if bending:
        _more_rows(
            s,
            (
                u[a - slice_ - row :],
                u[a - slice_ + row :],
                u[a + slice_ - row :],
                u[a + slice_ + row :],
            ),
            (u[a - 2 * row :], u[a + 2 * row :], u[a - 2 * slice_ :], u[a + 2 * slice_ :]),
            (tb3 * tb2, tb3 * td2, td3 * tb2, td3 * td2),
            (w3 * sa2, w3 * se2, w2 * sa3, w2 * se3),
            length,
        )
    # Columns but the two outer ones are alike.
    low = min(size, max(0, 2 - j))
    high = max(low, min(size, m - 2 - j))
    area = w3 * w2
    for r in range(rows):
        out, own = w[c * LINE + r * size :], w[(V + c) * LINE + r * size :]
        sums, here = s[r * row :], u[o - 2 + r * row :]
        _ends(out, sums, here, X1, j, area, 0, low, bending)
        _along(out[low:], sums[low:], here[low:], X1, m // 2, area, high - low, bending)
        _ends(out, sums, here, X1, j, area, high, size, bending)
        for x in range(size):
            own[x] = here[x + 2]


@njit(fastmath=FAST)
def _weigh(w, a):
    """Add ``volume A u``."""
    a11, a12, a13, a22, a23, a33 = a
    for j in range(a11.size):
        f = w[VOLUME * LINE + j]
        v1 = f * w[V * LINE + j]
        v2 = f * w[(V + 1) * LINE + j]
        v3 = f * w[(V + 2) * LINE + j]
        w[j] += a11[j] * v1 + a12[j] * v2 + a13[j] * v3
        w[LINE + j] += a12[j] * v1 + a22[j] * v2 + a23[j] * v3
        w[2 * LINE + j] += a13[j] * v1 + a23[j] * v2 + a33[j] * v3


@njit
def _lines(A, o, size, count):
    """Six lines of an array that is one line, from o on and each so many numbers further."""
    first = (A[o : o + size], A[o + count : o + count + size])
    o += 2 * count
    second = (A[o : o + size], A[o + count : o + count + size])
    o += 2 * count
    return (*first, *second, A[o : o + size], A[o + count : o + count + size])


@njit
def _entries(block, K):
    """The six entries of A in a block."""
    size = block.rows * (block.e - block.j)
    return _lines(K.A.reshape(K.A.size), _from(0, block, K.free.shape), size, K.free.size)


@njit
def _gather(near, u, block, shape):
    """Copy the rows of a block, those around it and those of the slices around, one by one.

    Return the distance of two rows. Rows of several go without the zeros between them, as G does.
    """
    n, m = shape[1:]
    row, alone = m + 4, int(block.rows == 1)
    step = block.e - block.j + 2 * alone
    for c in range(3):
        o = _at(c, block, shape)
        for k in range(3):
            first = o + (k - 1) * row * (n + 4)
            for r in range(block.rows + 2):
                here = u[first + (r - 1) * row - alone :]
                line = near[(3 * k + c) * NEAR + 1 + r * step - alone :]
                for x in range(step):
                    line[x] = here[x]
    return step


@njit(fastmath=FAST)
def _pull(s, p, q, a):
    """Add the products of symmetric matrices, given by six lines, with ``u_q - u_p``."""
    a11, a12, a13, a22, a23, a33 = a
    for j in range(a11.size):
        v1 = q[j] - p[j]
        v2 = q[NEAR + j] - p[NEAR + j]
        v3 = q[2 * NEAR + j] - p[2 * NEAR + j]
        s[j] += a11[j] * v1 + a12[j] * v2 + a13[j] * v3
        s[LINE + j] += a12[j] * v1 + a22[j] * v2 + a23[j] * v3
        s[2 * LINE + j] += a13[j] * v1 + a23[j] * v2 + a33[j] * v3


@njit
def _springs(w, near, u, block, K):
    """Add ``G (u_q - u_p)`` in a block, for the neighbours q of each node p."""
    k, i, j, e, rows = block
    l, n, m = K.free.shape
    G, count = K.G.reshape(K.G.size), K.free.size
    step = _gather(near, u, block, K.free.shape)
    p = 3 * NEAR + 1 + step
    for kind in range(1, 8):
        b3, b2, b1 = kind >> 2, kind >> 1 & 1, kind & 1
        for back3 in range(b3 + 1):
            ahead3 = b3 * (1 - 2 * back3)
            if not 0 <= k + ahead3 < l:
                continue
            for back2 in range(b2 + 1):
                ahead2 = b2 * (1 - 2 * back2)
                if not 0 <= i + ahead2 < n:
                    continue
                for back in range(b1 + 1):
                    # G is zero between rows. Before the first node, or after the last, is none.
                    skip, end = int(back == 1 and j == 0), int(b1 > back and e == m)
                    q = p + 3 * NEAR * ahead3 + step * ahead2 + b1 * (1 - 2 * back)
                    cell = ((6 * (kind - 1) * l + k - back3) * n + i - back2) * m + j - back
                    size = rows * (e - j) - skip - end
                    lines = _lines(G, cell + skip, size, count)
                    _pull(w[skip:], near[p + skip :], near[q + skip :], lines)


@njit(fastmath=FAST)
def _weights(w, block, K):
    """The volume of each node, and the sum over each row of ``|alpha R|``."""
    k, i, j, e, rows = block
    X1, X2, X3 = K.axes
    w3, w2 = X3[M, k], X2[M, i]
    c = w3 * X2[S_SUM, i] + w2 * X3[S_SUM, k] + X3[T_SUM, k] * X2[T_SUM, i]
    area, t = w3 * w2, w3 * X2[T_SUM, i] + w2 * X3[T_SUM, k]
    m1, s1, t1 = X1[M, j:e], X1[S_SUM, j:e], X1[T_SUM, j:e]
    for r in range(rows):
        volume = w[VOLUME * LINE + r * (e - j) :]
        for x in range(m1.size):
            volume[x] = area * m1[x]
            volume[BOUND * LINE - VOLUME * LINE + x] = c * m1[x] + area * s1[x] + t * t1[x]


@njit(fastmath=FAST)
def _block(w, near, u, block, K):
    """K u but for ``volume A u`` in a block, and u, written to w."""
    for c in range(3):
        _smoothness(w, c, u, block, K)
    if K.G.shape[0] > 0:
        _springs(w, near, u, block, K)


@njit(fastmath={"reassoc", "contract"})
def _dot(u, q):
    """``u . q`` of two rows: the same for any threads."""
    total = 0.0
    for j in range(q.size):
        total += u[j] * q[j]
    return total


@njit
def _inside(q, c, k, i, shape):
    """A row of a functional, or of the inside of a field."""
    m = shape[2]
    b = (q.shape[3] - m) // 2
    return q[c, k + b, i + b, b : b + m]


@compiled
def _product(first, last, q, sums, u, K):
    n, m = K.free.shape[1:]
    w, near = np.empty(LINES * LINE, K.axes[0].dtype), np.empty(9 * NEAR, u.dtype)
    zero, line = q.dtype.type(0), u.reshape(u.size)
    for k in range(first, last):
        i = 0
        while i < n:
            rows, columns = _blocks(i, n, K.free.shape)
            for j in range(0, m, columns):
                block = Block(k, i, j, min(j + columns, m), rows)
                size = block.e - j
                _block(w, near, line, block, K)
                _weights(w, block, K)
                _weigh(w, _entries(block, K))
                for c in range(3):
                    for r in range(rows):
                        qc, s = _inside(q, c, k, i + r, K.free.shape)[j:], w[c * LINE + r * size :]
                        free = K.free[k, i + r, j : block.e]
                        for x in range(free.size):
                            qc[x] = s[x] if free[x] else zero
            i += rows
        for c in range(3):
            for i in range(n):
                inner, own = u[c, k + 2, i + 2, 2 : m + 2], _inside(q, c, k, i, K.free.shape)
                sums[c, k, i] = _dot(inner, own)


def product(q: Real, u: Real, K: Operator) -> Array:
    """Write K u to the functional q; return ``u . K u`` summed over each row."""
    sums = np.empty((3, *K.shape[:2]))
    share(_product, K.shape[0], 3 * K.free.size, q, sums, u, K)
    return sums


@njit(fastmath=FAST)
def _correct(w, a):
    """Overwrite ``b - (K - volume A) u`` in w by ``D^-1 (b - K u)``.

    ``D = volume A + bound`` is factorised as a lower triangle, a diagonal and an upper triangle.
    """
    a11, a12, a13, a22, a23, a33 = a
    one = w.dtype.type(1)
    for j in range(a11.size):
        f, bound = w[VOLUME * LINE + j], w[BOUND * LINE + j]
        b11, b12, b13 = f * a11[j], f * a12[j], f * a13[j]
        b22, b23, b33 = f * a22[j], f * a23[j], f * a33[j]
        v1, v2, v3 = w[V * LINE + j], w[(V + 1) * LINE + j], w[(V + 2) * LINE + j]
        r1 = w[j] - (b11 * v1 + b12 * v2 + b13 * v3)
        r2 = w[LINE + j] - (b12 * v1 + b22 * v2 + b23 * v3)
        r3 = w[2 * LINE + j] - (b13 * v1 + b23 * v2 + b33 * v3)
        d1 = one / (b11 + bound)
        l2, l3 = b12 * d1, b13 * d1
        d2 = one / (b22 + bound - l2 * b12)
        e = b23 - l2 * b13
        l4 = e * d2
        d3 = b33 + bound - l3 * b13 - l4 * e
        r2 -= l2 * r1
        r3 = (r3 - l3 * r1 - l4 * r2) / d3
        r2 = r2 * d2 - l4 * r3
        w[2 * LINE + j] = r3
        w[LINE + j] = r2
        w[j] = r1 * d1 - l2 * r2 - l3 * r3


@njit(fastmath=FAST)
def _chebyshev(w, near, y, x, b, block, c1, c2, from_zero, K):
    """A step of the smoother in a block."""
    size, row, zero = block.e - block.j, K.free.shape[2] + 4, x.dtype.type(0)
    numbers = block.rows * size
    if not from_zero:
        _block(w, near, x, block, K)
    for c in range(3):
        bc, s = b[_from(c, block, K.free.shape) :], w[c * LINE :]
        if from_zero:
            for t in range(numbers):
                s[t] = bc[t]
                s[V * LINE + t] = zero
        else:
            for t in range(numbers):
                s[t] = bc[t] - s[t]
    _weights(w, block, K)
    _correct(w, _entries(block, K))
    for c in range(3):
        for r in range(block.rows):
            free = K.free[block.k, block.i + r, block.j : block.e]
            o, z = _at(c, block, K.free.shape) + r * row, w[c * LINE + r * size :]
            xc, yc = x[o:], y[o:]
            if from_zero:
                for t in range(free.size):
                    xc[t] = zero
                for t in range(free.size):
                    yc[t] = c2 * z[t] if free[t] else zero
            else:
                own = z[V * LINE :]
                for t in range(free.size):
                    yc[t] = own[t] + c1 * (own[t] - yc[t]) + (c2 * z[t] if free[t] else zero)


@compiled
def sweep(first, last, slabs, reach, x, y, b, c, from_zero, K):
    """Steps with the weights c on some slabs, see :func:`eofm.flow.sweeps.smooth`.

    The functional b has shape (3, l, n, m).
    """
    n, m = K.free.shape[1:]
    steps = c.shape[0]
    w, near = np.empty(LINES * LINE, x.dtype), np.empty(9 * NEAR, x.dtype)
    one, other, load = x.reshape(x.size), y.reshape(y.size), b.reshape(b.size)
    for slab in range(first, last):
        low, high = slabs[slab, :, 0], slabs[slab, :, 1]
        for top in range(0, n, ROWS):
            end = top + ROWS
            for front in range(low.min(), high.max() + reach * (steps - 1)):
                for step in range(steps):
                    k, behind = front - reach * step, reach * step
                    if not low[step] <= k < high[step]:
                        continue
                    old, new = (one, other) if step % 2 == 0 else (other, one)
                    zero = from_zero and step == 0
                    i, after = top - behind if top else 0, end - behind if end < n else n
                    while i < after:
                        rows, columns = _blocks(i, after, K.free.shape)
                        for j in range(0, m, columns):
                            block = Block(k, i, j, min(j + columns, m), rows)
                            _chebyshev(
                                w, near, new, old, load, block, c[step, 0], c[step, 1], zero, K
                            )
                        i += rows


@njit(fastmath=FAST)
def _collect(r, b, x, k, i, rows, columns, w, near, K):
    """Rows of b - K x, 0 where not free, of three components, to r of shape (3, rows, m)."""
    m = r.shape[2]
    zero = x.dtype.type(0)
    for j in range(0, m, columns):
        block = Block(k, i, j, min(j + columns, m), rows)
        size = block.e - j
        _block(w, near, x, block, K)
        _weights(w, block, K)
        _weigh(w, _entries(block, K))
        for c in range(3):
            for row in range(rows):
                rc, s = r[c, row, j : block.e], w[c * LINE + row * size :]
                bc, free = b[c, k, i + row, j:], K.free[k, i + row, j:]
                for t in range(rc.size):
                    rc[t] = bc[t] - s[t] if free[t] else zero


@njit(fastmath=FAST)
def _spread(R, r, t):
    """Add a row, times a number, to another."""
    for j in range(r.size):
        R[j] += t * r[j]


@compiled
def _restrict(first, last, rc, b, x, transfer, K):
    (J1, t1), (J2, t2), (J3, t3) = transfer
    n, m = J2.size, J1.size
    nc = rc.shape[2]
    one, line = b.dtype.type(1), x.reshape(x.size)
    w, near = np.empty(LINES * LINE, x.dtype), np.empty(9 * NEAR, x.dtype)
    r = np.empty((3, max(1, LINE // m), m), x.dtype)
    for strip in range(first, last):
        low, high = strip * STRIP, min((strip + 1) * STRIP, rc.shape[1])
        R = np.zeros((2, 3, nc, m), x.dtype)  # one slice, and the next
        for k in range(np.searchsorted(J3, low - 1), np.searchsorted(J3, high)):
            i = 0
            while i < n:
                rows, columns = _blocks(i, n, K.free.shape)
                _collect(r, b, line, k, i, rows, columns, w, near, K)
                for c in range(3):
                    for up in range(2):
                        t = t3[k] if up else one - t3[k]
                        for row in range(rows):
                            I, part = J2[i + row], t2[i + row]
                            _spread(R[up, c, I], r[c, row], t * (one - part))
                            _spread(R[up, c, I + 1], r[c, row], t * part)
                i += rows
            done = k + 1 == J3.size or J3[k + 1] > J3[k]
            if done and J3[k] >= low:
                _narrow(rc, J3[k], R[0], J1, t1)
            if k + 1 == J3.size and J3[k] + 1 < high:
                _narrow(rc, J3[k] + 1, R[1], J1, t1)
            if done:
                R[0] = R[1]
                R[1] = 0


@njit(fastmath=FAST)
def _narrow(rc, K, R, J1, t1):
    """Slice K of rc, from rows that are still as long as those of the fine grid."""
    one, zero = R.dtype.type(1), R.dtype.type(0)
    for c in range(3):
        for I in range(R.shape[1]):
            row, fine = rc[c, K, I], R[c, I]
            for J in range(row.size):
                row[J] = zero
            for j in range(fine.size):
                row[J1[j]] += (one - t1[j]) * fine[j]
                row[J1[j] + 1] += t1[j] * fine[j]


def restrict(rc: Real, b: Real, x: Real, transfer: Transfer, K: Operator) -> None:
    """Write to rc the transpose of the trilinear interpolation of :func:`prolong`, of b - K x."""
    strips = (rc.shape[1] - 1) // STRIP + 1
    share(_restrict, strips, 3 * K.free.size, rc, b, x, transfer, K)


@compiled
def _prolong(first, last, x, e, free, transfer):
    (J1, t1), (J2, t2), (J3, t3) = transfer
    one, zero = e.dtype.type(1), e.dtype.type(0)
    s = np.empty(e.shape[3], e.dtype)
    for k in range(first, last):
        for i in range(J2.size):
            for c in range(3):
                a1, a2 = e[c, J3[k] + 2, J2[i] + 2], e[c, J3[k] + 2, J2[i] + 3]
                b1, b2 = e[c, J3[k] + 3, J2[i] + 2], e[c, J3[k] + 3, J2[i] + 3]
                p, q = one - t3[k], one - t2[i]
                f1, f2, f3, f4 = p * q, p * t2[i], t3[k] * q, t3[k] * t2[i]
                for j in range(s.size):
                    s[j] = f1 * a1[j] + f2 * a2[j] + f3 * b1[j] + f4 * b2[j]
                row = x[c, k + 2, i + 2]
                for j in range(J1.size):
                    v = (one - t1[j]) * s[J1[j] + 2] + t1[j] * s[J1[j] + 3]
                    row[j + 2] += v if free[k, i, j] else zero


def prolong(x: Real, e: Real, free: Mask, transfer: Transfer) -> None:
    """Add the field e of the coarse grid to the field x on its free nodes."""
    share(_prolong, free.shape[0], 3 * free.size, x, e, free, transfer)


@njit(fastmath={"reassoc", "contract"})
def _advance_row(x, r, p, q, step):
    residual, change = 0.0, 0.0
    for j in range(r.size):
        d = step * p[j]
        x[j] += d
        r[j] -= step * q[j]
        residual += np.float64(r[j]) ** 2
        change += np.float64(d) ** 2
    return residual, change


@compiled
def _advance(first, last, sums, x, r, b, p, q, step):
    shape = r.shape[1:]
    for k in range(first, last):
        for i in range(shape[1]):
            for c in range(3):
                xc, pc = _inside(x, c, k, i, shape), _inside(p, c, k, i, shape)
                rc, qc = r[c, k, i], _inside(q, c, k, i, shape)
                squares = _advance_row(xc, rc, pc, qc, step)
                sums[0, c, k, i], sums[1, c, k, i] = squares
                bc = b[c, k, i]
                for j in range(bc.size):
                    bc[j] = rc[j]


def advance(x: Real, r: Real, b: Real, p: Real, q: Real, step: float) -> Array:
    """``x += step p``, ``r -= step q``, ``b = r``, where b may be r itself.

    Return the squares of r and of the change of x, summed over each row.
    """
    sums = np.empty((2, *r.shape[:-1]))
    share(_advance, r.shape[1], r.size, sums, x, r, b, p, q, r.dtype.type(step))
    return sums


@compiled
def _dots(first, last, sums, z, r):
    shape = r.shape[1:]
    for k in range(first, last):
        for i in range(shape[1]):
            for c in range(3):
                sums[c, k, i] = _dot(_inside(z, c, k, i, shape), r[c, k, i])


def dot(z: Real, r: Real) -> Array:
    """``z . r`` of a field and a functional, summed over each row."""
    sums = np.empty(r.shape[:-1])
    share(_dots, r.shape[1], r.size, sums, z, r)
    return sums


def norm(r: Real) -> float:
    """Euclidean norm of a functional, or of the inside of a field."""
    return math.sqrt(dot(r, r).sum())


@compiled
def _redirect(first, last, p, z, beta):
    for k in range(first, last):
        for c in range(3):
            for i in range(p.shape[2]):
                pi, zi = p[c, k, i], z[c, k, i]
                for j in range(pi.size):
                    pi[j] = zi[j] + beta * pi[j]


def redirect(p: Real, z: Real, beta: float) -> None:
    """``p = z + beta p`` for fields."""
    share(_redirect, p.shape[1], p.size, p, z, p.dtype.type(beta))
