"""Loops over pixels for :mod:`eofm.imaging.splines`, compiled and parallel over rows or strips.

Coefficients of cubic splines have shape (n + 3, m + 3) for an image of n rows and m columns:
those of pixel (i, j) stand at (i + 1, j + 1), framed by one row and column before and two
after that continue them, here as in a mirror. So the spline's value anywhere in the image is a sum
over 4 x 4 coefficients, without questions at the edges.

Every row or strip is computed by one thread, in one order: results do not depend on the
number of threads.
"""

import math

import numpy as np
from numba import njit, prange

# Pixels below which handing rows to threads costs more than it saves.
SERIAL = 2**16
# The recursive filter that turns samples into coefficients: its pole, and where the powers
# of the pole are zero up to rounding.
POLE = math.sqrt(3) - 2
HORIZON = 30
# Columns, or rows, that one thread computes together.
STRIP = 64


@njit(cache=True)
def _filter_row(c, samples):
    """Write the coefficients of a row of samples to c, and continue them."""
    n = samples.size
    c[1 : n + 1] = samples
    if n > 1:
        period = 2 * n - 2
        total = 0.0
        for k in range(min(HORIZON, period) - 1, -1, -1):
            total = total * POLE + c[1 + min(k, period - k)]
        last = total / (1 - POLE ** float(period))
        c[1] = 6 * last
        for j in range(2, n + 1):
            last = c[j] + POLE * last
            c[j] = 6 * last
        last = (c[n] + POLE * c[n - 1]) * POLE / (POLE * POLE - 1)
        c[n] = last
        for j in range(n - 1, 0, -1):
            last = POLE * (last - c[j])
            c[j] = last
    c[0] = c[min(2, n)]
    c[n + 1] = c[max(n - 1, 1)]
    c[n + 2] = c[max(n - 2, 1)]


@njit(cache=True)
def _filter_strip(c, n, first):
    """Do the same in place along the columns, from the first one of a strip onwards."""
    c = c[:, first : first + STRIP]
    if n > 1:
        period = 2 * n - 2
        total = np.zeros(c.shape[1])
        for k in range(min(HORIZON, period) - 1, -1, -1):
            total = total * POLE + c[1 + min(k, period - k)]
        c[1] = total * (6 / (1 - POLE ** float(period)))
        for i in range(2, n + 1):
            for j in range(c.shape[1]):
                c[i, j] = 6 * c[i, j] + POLE * c[i - 1, j]
        for j in range(c.shape[1]):
            c[n, j] = (c[n, j] + POLE * c[n - 1, j]) * POLE / (POLE * POLE - 1)
        for i in range(n - 1, 0, -1):
            for j in range(c.shape[1]):
                c[i, j] = POLE * (c[i + 1, j] - c[i, j])
    c[0] = c[min(2, n)]
    c[n + 1] = c[max(n - 1, 1)]
    c[n + 2] = c[max(n - 2, 1)]


@njit(cache=True, parallel=True)
def coefficients(c, I):
    """Write the coefficients of the cubic spline through an image to c."""
    n, m = I.shape
    strips = (m + 2) // STRIP + 1
    if I.size < SERIAL:
        for i in range(n):
            _filter_row(c[i + 1], I[i])
        for k in range(strips):
            _filter_strip(c, n, k * STRIP)
    else:
        for i in prange(n):
            _filter_row(c[i + 1], I[i])
        for k in prange(strips):
            _filter_strip(c, n, k * STRIP)


@njit(cache=True)
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


_weights = njit(cache=True)(weights)


@njit(cache=True)
def _sample_row(values, gradients, inside, c, u, i, step):
    n, m = c.shape[0] - 3, c.shape[1] - 3
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


@njit(cache=True, parallel=True)
def sample(values, gradients, inside, c, u, step):
    """Evaluate a spline at ``x = u + step (column, row)``.

    values, inside: shape (k, l); gradients: shape (2, k, l), or (0, k, l) if not wanted;
    u: shape (2, k, l). Points outside take the value of the nearest border point.
    """
    if values.size < SERIAL:
        for i in range(values.shape[0]):
            _sample_row(values, gradients, inside, c, u, i, step)
    else:
        for i in prange(values.shape[0]):
            _sample_row(values, gradients, inside, c, u, i, step)


@njit(cache=True)
def _slope_row(g, c, i):
    above, here, below = c[i], c[i + 1], c[i + 2]
    for j in range(g.shape[2]):
        left = above[j] + 4 * here[j] + below[j]
        right = above[j + 2] + 4 * here[j + 2] + below[j + 2]
        top = above[j] + 4 * above[j + 1] + above[j + 2]
        bottom = below[j] + 4 * below[j + 1] + below[j + 2]
        g[0, i, j], g[1, i, j] = (right - left) / 12, (bottom - top) / 12


@njit(cache=True, parallel=True)
def slopes(g, c):
    """Write the gradient of a spline at the pixels to g, shape (2, n, m)."""
    if g.size < SERIAL:
        for i in range(g.shape[1]):
            _slope_row(g, c, i)
    else:
        for i in prange(g.shape[1]):
            _slope_row(g, c, i)


@njit(cache=True)
def _resample_row(row, c, i, at1, w1, at2, w2):
    s = np.zeros(c.shape[1])
    for k in range(at2.shape[1]):
        source, weight = c[at2[i, k]], w2[i, k]
        for j in range(s.size):
            s[j] += weight * source[j]
    for j in range(row.size):
        total = 0.0
        for k in range(at1.shape[1]):
            total += w1[j, k] * s[at1[j, k]]
        row[j] = total


@njit(cache=True, parallel=True)
def resample(J, c, at1, w1, at2, w2):
    """Write to J the sums of entries ``at`` of c with weights ``w``, along both axes.

    at1, w1: shape (columns of J, number of terms); at2, w2: the same for rows.
    """
    if J.size < SERIAL:
        for i in range(J.shape[0]):
            _resample_row(J[i], c, i, at1, w1, at2, w2)
    else:
        for i in prange(J.shape[0]):
            _resample_row(J[i], c, i, at1, w1, at2, w2)


@njit(cache=True)
def _add_to_strip(total, low, x1, x2, centres, sigma, weights, columns, rows):
    high = min(low + STRIP, x2.size)
    g1 = np.empty(x1.size)
    for k in range(sigma.size):
        if rows[0, k] >= high or rows[1, k] <= low:
            continue
        first, size = columns[0, k], columns[1, k] - columns[0, k]
        factor = -0.5 / sigma[k] ** 2
        for j in range(size):
            g1[j] = math.exp(factor * (x1[first + j] - centres[0, k]) ** 2)
        for i in range(max(low, rows[0, k]), min(high, rows[1, k])):
            g2 = math.exp(factor * (x2[i] - centres[1, k]) ** 2)
            for l in range(weights.shape[0]):
                height, target = weights[l, k] * g2, total[l, i, first : first + size]
                for j in range(size):
                    target[j] += height * g1[j]


@njit(cache=True, parallel=True)
def add_gaussians(total, x1, x2, centres, sigma, weights, columns, rows):
    """Add Gaussians, each cut off outside of its columns and rows, to the sums total.

    columns, rows: shape (2, M), the first and the one after the last of each Gaussian;
    for the others see :func:`eofm.imaging.splines.gaussians`.
    """
    for strip in prange((x2.size - 1) // STRIP + 1):
        _add_to_strip(total, strip * STRIP, x1, x2, centres, sigma, weights, columns, rows)
