"""Loops over pixels for :mod:`eofm.imaging.splines`, compiled and shared by rows or slices.

Coefficients of cubic splines have 3 entries more than the image or volume along every axis: those
of pixel (i, j) stand at (i + 1, j + 1), framed by one entry before and two after that continue
them, here as in a mirror. So the spline's value anywhere in it is a sum over 4 x 4 coefficients,
or 4 x 4 x 4, without questions at the edges.

Every row, slice or strip is computed by one thread, in one order: results do not depend on the
number of threads.
"""

import math

import numpy as np
from numba import njit

from eofm.compiled import compiled, share
from eofm.grid import Array, Mask

# The recursive filter that turns samples into coefficients: its pole, and where the powers
# of the pole are zero up to rounding.
POLE = math.sqrt(3) - 2
HORIZON = 30
# Columns, or rows, that are computed together.
STRIP = 64


@compiled
def _filter_rows(first, last, c, I):
    """Write the coefficients of rows of samples to c, and continue them."""
    n = I.shape[1]
    period = 2 * n - 2
    for i in range(first, last):
        row = c[i + 1]
        for j in range(n):
            row[j + 1] = I[i, j]
        if n > 1:
            total = 0.0
            for k in range(min(HORIZON, period) - 1, -1, -1):
                total = total * POLE + row[1 + min(k, period - k)]
            last_one = total / (1 - POLE ** float(period))
            row[1] = 6 * last_one
            for j in range(2, n + 1):
                last_one = row[j] + POLE * last_one
                row[j] = 6 * last_one
            last_one = (row[n] + POLE * row[n - 1]) * POLE / (POLE * POLE - 1)
            row[n] = last_one
            for j in range(n - 1, 0, -1):
                last_one = POLE * (last_one - row[j])
                row[j] = last_one
        row[0] = row[min(2, n)]
        row[n + 1] = row[max(n - 1, 1)]
        row[n + 2] = row[max(n - 2, 1)]


@compiled
def _filter_columns(first, last, c):
    """Do the same in place along the columns of strips."""
    n = c.shape[0] - 3
    period = 2 * n - 2
    for low in range(first * STRIP, min(last * STRIP, c.shape[1]), STRIP):
        high = min(low + STRIP, c.shape[1])
        if n > 1:
            total = np.zeros(high - low)
            for k in range(min(HORIZON, period) - 1, -1, -1):
                for j in range(low, high):
                    total[j - low] = total[j - low] * POLE + c[1 + min(k, period - k), j]
            factor = 6 / (1 - POLE ** float(period))
            for j in range(low, high):
                c[1, j] = total[j - low] * factor
            for i in range(2, n + 1):
                for j in range(low, high):
                    c[i, j] = 6 * c[i, j] + POLE * c[i - 1, j]
            for j in range(low, high):
                c[n, j] = (c[n, j] + POLE * c[n - 1, j]) * POLE / (POLE * POLE - 1)
            for i in range(n - 1, 0, -1):
                for j in range(low, high):
                    c[i, j] = POLE * (c[i + 1, j] - c[i, j])
        for j in range(low, high):
            c[0, j] = c[min(2, n), j]
            c[n + 1, j] = c[max(n - 1, 1), j]
            c[n + 2, j] = c[max(n - 2, 1), j]


@compiled
def _filter_slices(first, last, c, I):
    """Write the coefficients along both axes of slices of samples to c."""
    for i in range(first, last):
        _filter_rows(0, I.shape[1], c[i + 1], I[i])
        _filter_columns(0, (I.shape[2] + 2) // STRIP + 1, c[i + 1])


def coefficients(c: Array, I: Array) -> None:
    """Write the coefficients of the cubic spline through an image or a volume to c."""
    share(_filter_rows if I.ndim == 2 else _filter_slices, I.shape[0], I.size, c, I)
    lines = c.reshape(len(c), -1)
    share(_filter_columns, (lines.shape[1] - 1) // STRIP + 1, I.size, lines)


@compiled
def _turn(first, last, c, power, reach):
    n, m = c.shape[1] - 3, c.shape[2]
    strips, far = (m - 1) // STRIP + 1, power[-1]
    ends = np.empty((2, STRIP))
    for line in range(first, last):
        lines, low = c[line // strips], line % strips * STRIP
        high = min(low + STRIP, m)
        for j in range(low, high):
            start, end = (lines[2, j] - lines[1, j]) / 3, (lines[n - 1, j] - lines[n, j]) / 3
            ends[0, j - low], ends[1, j - low] = start - far * end, end - far * start
        for k in range(reach):
            for j in range(low, high):
                lines[1 + k, j] += power[k] * ends[0, j - low] / (1 - far * far)
        for k in range(reach):
            for j in range(low, high):
                lines[n - k, j] += power[k] * ends[1, j - low] / (1 - far * far)
        for j in range(low, high):
            lines[0, j] = 2 * lines[1, j] - lines[2, j]
            lines[n + 1, j] = 2 * lines[n, j] - lines[n - 1, j]
            lines[n + 2, j] = 2 * lines[n, j] - lines[n - 2, j]


def turn(c: Array, axis: int) -> None:
    """Make coefficients that are mirrored along an axis those of a spline that is odd there.

    Its second derivative is zero at the ends, where the coefficients are the samples. The
    differences are taken to the inside by the powers of the pole, whose spline is zero at the
    samples in between.
    """
    n = c.shape[axis] - 3
    if n == 1:
        return
    lines = c.reshape(math.prod(c.shape[:axis]), n + 3, math.prod(c.shape[axis + 1 :]))
    reach = n if c.dtype == np.float64 else min(n, HORIZON)
    strips = (lines.shape[2] - 1) // STRIP + 1
    share(_turn, len(lines) * strips, c.size, lines, POLE ** np.arange(n), reach)


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


@njit
def _row(c, j3, j2, j1, w, d):
    """Value and slope along a row of coefficients."""
    q, r, s, t = c[j3, j2, j1], c[j3, j2, j1 + 1], c[j3, j2, j1 + 2], c[j3, j2, j1 + 3]
    value = w[0] * q + w[1] * r + w[2] * s + w[3] * t
    return value, d[0] * q + d[1] * r + d[2] * s + d[3] * t


@njit
def _plane(c, j3, j2, j1, w1, d1, w2, d2):
    """Value and both slopes in a slice of coefficients."""
    (p, a), (q, b) = _row(c, j3, j2, j1, w1, d1), _row(c, j3, j2 + 1, j1, w1, d1)
    (r, e), (s, f) = _row(c, j3, j2 + 2, j1, w1, d1), _row(c, j3, j2 + 3, j1, w1, d1)
    value = w2[0] * p + w2[1] * q + w2[2] * r + w2[3] * s
    along1 = w2[0] * a + w2[1] * b + w2[2] * e + w2[3] * f
    return value, along1, d2[0] * p + d2[1] * q + d2[2] * r + d2[3] * s


@njit
def _column(c, j3, j2, j1, w2):
    """Value along a column of coefficients."""
    p, q, r, s = c[j3, j2, j1], c[j3, j2 + 1, j1], c[j3, j2 + 2, j1], c[j3, j2 + 3, j1]
    return w2[0] * p + w2[1] * q + w2[2] * r + w2[3] * s


@njit
def _single(w):
    return np.float32(w[0]), np.float32(w[1]), np.float32(w[2]), np.float32(w[3])


@compiled
def _sample_slices(first, last, values, gradients, inside, c, u, step):
    n, m, l = c.shape[0] - 3, c.shape[1] - 3, c.shape[2] - 3
    row = np.empty(4, c.dtype)
    for h in range(first, last):
        for i in range(values.shape[1]):
            for k in range(values.shape[2]):
                x1, x2 = u[0, h, i, k] + step * k, u[1, h, i, k] + step * i
                x3 = u[2, h, i, k] + step * h
                inside[h, i, k] = 0 <= x1 <= l - 1 and 0 <= x2 <= m - 1 and 0 <= x3 <= n - 1
                (j1, t1), (j2, t2), (j3, t3) = _locate(x1, l), _locate(x2, m), _locate(x3, n)
                (w1, d1), (w2, d2), (w3, d3) = _weights(t1), _weights(t2), _weights(t3)
                w1, d1, w2, d2 = _single(w1), _single(d1), _single(w2), _single(d2)
                w3, d3 = _single(w3), _single(d3)
                if not gradients.shape[0]:
                    for p in range(4):
                        q, r = _column(c, j3, j2, j1 + p, w2), _column(c, j3 + 1, j2, j1 + p, w2)
                        s, t = (
                            _column(c, j3 + 2, j2, j1 + p, w2),
                            _column(c, j3 + 3, j2, j1 + p, w2),
                        )
                        row[p] = w3[0] * q + w3[1] * r + w3[2] * s + w3[3] * t
                    values[h, i, k] = (
                        w1[0] * row[0] + w1[1] * row[1] + w1[2] * row[2] + w1[3] * row[3]
                    )
                    continue
                p0, a0, b0 = _plane(c, j3, j2, j1, w1, d1, w2, d2)
                p1, a1, b1 = _plane(c, j3 + 1, j2, j1, w1, d1, w2, d2)
                p2, a2, b2 = _plane(c, j3 + 2, j2, j1, w1, d1, w2, d2)
                p3, a3, b3 = _plane(c, j3 + 3, j2, j1, w1, d1, w2, d2)
                values[h, i, k] = w3[0] * p0 + w3[1] * p1 + w3[2] * p2 + w3[3] * p3
                gradients[0, h, i, k] = w3[0] * a0 + w3[1] * a1 + w3[2] * a2 + w3[3] * a3
                gradients[1, h, i, k] = w3[0] * b0 + w3[1] * b1 + w3[2] * b2 + w3[3] * b3
                gradients[2, h, i, k] = d3[0] * p0 + d3[1] * p1 + d3[2] * p2 + d3[3] * p3


def sample(values: Array, gradients: Array, inside: Mask, c: Array, u: Array, step: float) -> None:
    """Evaluate a spline at ``x = u + step (column, row)``, or (column, row, slice).

    values, inside: shape (k, l); gradients: shape (2, k, l), or (0, k, l) if not wanted;
    u: shape (2, k, l); with one axis more of volumes. Points outside take the value of the
    nearest border point.
    """
    kernel = _sample if c.ndim == 2 else _sample_slices
    share(kernel, values.shape[0], values.size, values, gradients, inside, c, u, step)


@compiled
def _slopes(first, last, g, c):
    for i in range(first, last):
        above, here, below = c[i], c[i + 1], c[i + 2]
        for j in range(g.shape[2]):
            left = above[j] + 4 * here[j] + below[j]
            right = above[j + 2] + 4 * here[j + 2] + below[j + 2]
            top = above[j] + 4 * above[j + 1] + above[j + 2]
            bottom = below[j] + 4 * below[j + 1] + below[j + 2]
            g[0, i, j], g[1, i, j] = (right - left) / 12, (bottom - top) / 12


@compiled
def _slopes_of_slices(first, last, g, c):
    s = np.empty((3, c.shape[2]), c.dtype)
    for h in range(first, last):
        for i in range(g.shape[2]):
            p0, p1, p2 = c[h, i], c[h, i + 1], c[h, i + 2]
            q0, q1, q2 = c[h + 1, i], c[h + 1, i + 1], c[h + 1, i + 2]
            r0, r1, r2 = c[h + 2, i], c[h + 2, i + 1], c[h + 2, i + 2]
            for j in range(c.shape[2]):
                front, back = p0[j] + 4 * p1[j] + p2[j], r0[j] + 4 * r1[j] + r2[j]
                s[0, j] = front + 4 * (q0[j] + 4 * q1[j] + q2[j]) + back
                s[1, j] = p2[j] - p0[j] + 4 * (q2[j] - q0[j]) + r2[j] - r0[j]
                s[2, j] = back - front
            for j in range(g.shape[3]):
                g[0, h, i, j] = (s[0, j + 2] - s[0, j]) / 72
                g[1, h, i, j] = (s[1, j] + 4 * s[1, j + 1] + s[1, j + 2]) / 72
                g[2, h, i, j] = (s[2, j] + 4 * s[2, j + 1] + s[2, j + 2]) / 72


def slopes(g: Array, c: Array) -> None:
    """Write the gradient of a spline at the pixels to g, shape (2, n, m) or (3, k, n, m)."""
    share(_slopes if c.ndim == 2 else _slopes_of_slices, g.shape[1], g.size, g, c)
