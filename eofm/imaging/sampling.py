"""Splines at points, compiled and shared by rows or slices; coefficients as in :mod:`.kernels`.

A volume's value is a sum over 64 coefficients. Displacements are smooth: most neighbours along a
row fall between the same rows of coefficients, each one sample further than the one before. Such
runs are computed side by side, from copies of their rows: three times as fast. Every value is the
same sum in the same order, in a run or alone.
"""

import numpy as np
from numba import njit

from eofm.compiled import compiled, share
from eofm.grid import Array, Mask

# Longest run, and the shortest that is worth its copies.
LANES, SHORT = 16, 3
# What a run is computed in: 16 rows of coefficients, the parts of a sample that points are past
# the one before them, and results. That all is one array tells the compiler what is apart.
ROW = LANES + 4
PARTS, RESULTS = 16 * ROW, 16 * ROW + 3 * LANES


@njit
def _locate(x, n):
    """The sample before x, for x in the range of n samples, and the distance from it."""
    x = min(x, n - 1.0) if x > 0 else 0.0
    j = max(min(int(x), n - 2), 0)
    return j, x - j


def weights(t):
    """Weights of the coefficients around a point t past a sample, and their derivatives."""
    s = 1 - t
    a, b = s * s * s / 6, t * t * t / 6
    w = (a, 2 / 3 - t * t * (2 - t) / 2, 2 / 3 - s * s * (2 - s) / 2, b)
    d = (-s * s / 2, t * (1.5 * t - 2), s * (2 - 1.5 * s), t * t / 2)
    return w, d


_weights = njit(weights)


@compiled
def _sample(first, last, values, gradients, inside, c, u, step):
    n, m = c.shape[0] - 3, c.shape[1] - 3
    for i in range(first, last):
        for k in range(values.shape[1]):
            x1, x2 = u[0, i, k] + step * k, u[1, i, k] + step * i
            inside[i, k] = 0 <= x1 <= m - 1 and 0 <= x2 <= n - 1
            j1, t1 = _locate(x1, m)
            j2, t2 = _locate(x2, n)
            (a1, b1, c1, d1), (e1, f1, g1, h1) = _weights(t1)
            w2, v2 = _weights(t2)
            total, along1, along2 = 0.0, 0.0, 0.0
            for p in range(4):
                q, r, s, t = c[j2 + p, j1], c[j2 + p, j1 + 1], c[j2 + p, j1 + 2], c[j2 + p, j1 + 3]
                row = a1 * q + b1 * r + c1 * s + d1 * t
                total += w2[p] * row
                along2 += v2[p] * row
                along1 += w2[p] * (e1 * q + f1 * r + g1 * s + h1 * t)
            values[i, k] = total
            if gradients.shape[0]:
                gradients[0, i, k], gradients[1, i, k] = along1, along2


@njit(inline="always")
def _single(t):
    """Weights in single precision, and their derivatives."""
    one, two, half = np.float32(1), np.float32(2), np.float32(0.5)
    sixth, thirds, s = np.float32(1 / 6), np.float32(2 / 3), np.float32(1) - t
    w0, w3 = s * s * s * sixth, t * t * t * sixth
    w1, w2 = thirds - t * t * (one - half * t), thirds - s * s * (one - half * s)
    d1, d2 = t * (one + half) * t - two * t, s * two - s * (one + half) * s
    return (w0, w1, w2, w3), (-s * s * half, d1, d2, t * t * half)


@njit(inline="always")
def _sum(w, p, q, r, s):
    return w[0] * p + w[1] * q + w[2] * r + w[3] * s


@njit(inline="always")
def _line(c, at, step, w):
    return _sum(w, c[at], c[at + step], c[at + 2 * step], c[at + 3 * step])


@njit(inline="always")
def _column(c, at, s2, s3, w2, w3):
    """Value between 4 x 4 coefficients of one column, s2 and s3 apart."""
    p, q = _line(c, at, s2, w2), _line(c, at + s3, s2, w2)
    return _sum(w3, p, q, _line(c, at + 2 * s3, s2, w2), _line(c, at + 3 * s3, s2, w2))


@njit(inline="always")
def _sloping(c, at, s2, s3, w2, d2, w3, d3):
    """The same, and the axial and the elevational slope."""
    p, q = _line(c, at, s2, w2), _line(c, at + s3, s2, w2)
    r, s = _line(c, at + 2 * s3, s2, w2), _line(c, at + 3 * s3, s2, w2)
    a, b = _line(c, at, s2, d2), _line(c, at + s3, s2, d2)
    e, f = _line(c, at + 2 * s3, s2, d2), _line(c, at + 3 * s3, s2, d2)
    return _sum(w3, p, q, r, s), _sum(w3, a, b, e, f), _sum(d3, p, q, r, s)


@njit
def _one(c, at, s2, s3, t1, t2, t3, s):
    """Value and gradient at a point, s being room."""
    (w1, d1), (w2, d2), (w3, d3) = _single(t1), _single(t2), _single(t3)
    for k in range(4):
        s[0, k], s[1, k], s[2, k] = _sloping(c, at + k, s2, s3, w2, d2, w3, d3)
    value, along1 = _line(s[0], 0, 1, w1), _line(s[0], 0, 1, d1)
    return value, along1, _line(s[1], 0, 1, w1), _line(s[2], 0, 1, w1)


@njit
def _value(c, at, s2, s3, t1, t2, t3, s):
    (w1, _), (w2, _), (w3, _) = _single(t1), _single(t2), _single(t3)
    for k in range(4):
        s[0, k] = _column(c, at + k, s2, s3, w2, w3)
    return _line(s[0], 0, 1, w1)


@njit
def _run(work):
    """Values and gradients side by side."""
    for k in range(LANES):
        w1, d1 = _single(work[PARTS + k])
        w2, d2 = _single(work[PARTS + LANES + k])
        w3, d3 = _single(work[PARTS + 2 * LANES + k])
        p, a, e = _sloping(work, k, ROW, 4 * ROW, w2, d2, w3, d3)
        q, b, f = _sloping(work, k + 1, ROW, 4 * ROW, w2, d2, w3, d3)
        r, c, g = _sloping(work, k + 2, ROW, 4 * ROW, w2, d2, w3, d3)
        s, d, h = _sloping(work, k + 3, ROW, 4 * ROW, w2, d2, w3, d3)
        work[RESULTS + k], work[RESULTS + LANES + k] = _sum(w1, p, q, r, s), _sum(d1, p, q, r, s)
        work[RESULTS + 2 * LANES + k] = _sum(w1, a, b, c, d)
        work[RESULTS + 3 * LANES + k] = _sum(w1, e, f, g, h)


@njit
def _place(at, t, inside, c, u, h, i, step):
    """Where coefficients of a row of points begin, less their number; parts past samples."""
    n, m, l = c.shape[0] - 3, c.shape[1] - 3, c.shape[2] - 3
    for k in range(at.size):
        x1, x2 = u[0, h, i, k] + step * k, u[1, h, i, k] + step * i
        x3 = u[2, h, i, k] + step * h
        inside[h, i, k] = 0 <= x1 <= l - 1 and 0 <= x2 <= m - 1 and 0 <= x3 <= n - 1
        (j1, t1), (j2, t2), (j3, t3) = _locate(x1, l), _locate(x2, m), _locate(x3, n)
        t[0, k], t[1, k], t[2, k] = t1, t2, t3
        at[k] = (j3 * c.shape[1] + j2) * c.shape[2] + j1 - k


@njit
def _copy(work, c, start, s2, s3, t, k):
    """What a run of points from number k on needs."""
    for p in range(4):
        for q in range(4):
            for j in range(ROW):
                work[(4 * p + q) * ROW + j] = c[start + p * s3 + q * s2 + j]
    for p in range(3):
        for j in range(LANES):
            work[PARTS + p * LANES + j] = t[p, k + j]


@compiled
def _sample_slices(first, last, values, gradients, inside, c, u, step):
    width, s2, s3, line = values.shape[2], c.shape[2], c.shape[1] * c.shape[2], c.ravel()
    end = line.size - 3 * (s2 + s3) - ROW
    at, t = np.empty(width, np.int64), np.zeros((3, width + LANES), np.float32)
    s, work = np.empty((3, 4), np.float32), np.empty(RESULTS + 4 * LANES, np.float32)
    for h in range(first, last):
        for i in range(values.shape[1]):
            _place(at, t, inside, c, u, h, i, step)
            row, slopes = values[h, i], gradients[:, h, i]
            k = 0
            while k < width:
                start, count = at[k] + k, 1
                while count < min(LANES, width - k) and at[k + count] == at[k]:
                    count += 1
                if count >= SHORT and start <= end:
                    _copy(work, line, start, s2, s3, t, k)
                    _run(work)
                    for j in range(count):
                        row[k + j] = work[RESULTS + j]
                    for p in range(slopes.shape[0]):
                        for j in range(count):
                            slopes[p, k + j] = work[RESULTS + (p + 1) * LANES + j]
                    k += count
                    continue
                if slopes.shape[0]:
                    row[k], slopes[0, k], slopes[1, k], slopes[2, k] = _one(
                        line, start, s2, s3, t[0, k], t[1, k], t[2, k], s
                    )
                else:
                    row[k] = _value(line, start, s2, s3, t[0, k], t[1, k], t[2, k], s)
                k += 1


def sample(values: Array, gradients: Array, inside: Mask, c: Array, u: Array, step: float) -> None:
    """Evaluate a spline at ``x = u + step (column, row)``, or (column, row, slice).

    values, inside: shape (k, l); gradients: shape (2, k, l), or (0, k, l) if not wanted;
    u: shape (2, k, l); with one axis more of volumes. Points outside take the value of the
    nearest border point.
    """
    kernel = _sample if c.ndim == 2 else _sample_slices
    share(kernel, values.shape[0], values.size, values, gradients, inside, c, u, step)
