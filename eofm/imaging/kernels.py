"""Loops over pixels for :mod:`eofm.imaging.splines`, compiled and shared by rows or strips.

Coefficients of cubic splines have shape (n + 3, m + 3) for an image of n rows and m columns:
those of pixel (i, j) stand at (i + 1, j + 1), framed by one row and column before and two
after that continue them, here as in a mirror. So the spline's value anywhere in the image is a sum
over 4 x 4 coefficients, without questions at the edges.

Every row or strip is computed by one thread, in one order: results do not depend on the
number of threads.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from eofm.compiled import compiled, share
from eofm.grid import Array, Mask

# The recursive filter that turns samples into coefficients: its pole, and where the powers
# of the pole are zero up to rounding.
POLE = math.sqrt(3) - 2
HORIZON = 30
# Columns, or rows, that are computed together.
STRIP = 64


class Terms(NamedTuple):
    """Which entries along an axis make a new one.

    Attributes
    ----------
    at : ndarray of int, shape (n, number of terms)
    w : ndarray, shape (n, number of terms)
        Their weights.
    """

    at: NDArray[np.intp]
    w: Array


class Bumps(NamedTuple):
    """M Gaussians of height 1, each cut off outside of its columns and rows.

    Attributes
    ----------
    centres : ndarray, shape (2, M)
        Lateral and axial.
    sigma : ndarray, shape (M,)
    columns, rows : ndarray of int, shape (2, M)
        The first and the one after the last of each.
    """

    centres: Array
    sigma: Array
    columns: NDArray[np.intp]
    rows: NDArray[np.intp]


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


def coefficients(c: Array, I: Array) -> None:
    """Write the coefficients of the cubic spline through an image to c."""
    share(_filter_rows, I.shape[0], I.size, c, I)
    share(_filter_columns, (I.shape[1] + 2) // STRIP + 1, I.size, c)


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


def sample(values: Array, gradients: Array, inside: Mask, c: Array, u: Array, step: float) -> None:
    """Evaluate a spline at ``x = u + step (column, row)``.

    values, inside: shape (k, l); gradients: shape (2, k, l), or (0, k, l) if not wanted;
    u: shape (2, k, l). Points outside take the value of the nearest border point.
    """
    share(_sample, values.shape[0], values.size, values, gradients, inside, c, u, step)


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


def slopes(g: Array, c: Array) -> None:
    """Write the gradient of a spline at the pixels to g, shape (2, n, m)."""
    share(_slopes, g.shape[1], g.size, g, c)


@compiled
def _resample(first, last, J, c, lateral, axial):
    s = np.empty(c.shape[1])
    for i in range(first, last):
        s[:] = 0
        for k in range(axial.at.shape[1]):
            source, weight = c[axial.at[i, k]], axial.w[i, k]
            for j in range(s.size):
                s[j] += weight * source[j]
        for j in range(J.shape[1]):
            total = 0.0
            for k in range(lateral.at.shape[1]):
                total += lateral.w[j, k] * s[lateral.at[j, k]]
            J[i, j] = total


def resample(J: Array, c: Array, lateral: Terms, axial: Terms) -> None:
    """Write to J sums of entries of c along both axes."""
    share(_resample, J.shape[0], J.size, J, c, lateral, axial)


@compiled
def _add_gaussians(first, last, total, axes, bumps, weights):
    (x1, x2), (centres, sigma, columns, rows) = axes, bumps
    low, high = first * STRIP, min(last * STRIP, x2.size)
    g1 = np.empty(x1.size)
    for k in range(sigma.size):
        if rows[0, k] >= high or rows[1, k] <= low:
            continue
        start, size = columns[0, k], columns[1, k] - columns[0, k]
        factor = -0.5 / sigma[k] ** 2
        for j in range(size):
            g1[j] = math.exp(factor * (x1[start + j] - centres[0, k]) ** 2)
        for i in range(max(low, rows[0, k]), min(high, rows[1, k])):
            g2 = math.exp(factor * (x2[i] - centres[1, k]) ** 2)
            for l in range(weights.shape[0]):
                height = weights[l, k] * g2
                for j in range(size):
                    total[l, i, start + j] += height * g1[j]


def add_gaussians(total: Array, axes: tuple[Array, Array], bumps: Bumps, weights: Array) -> None:
    """Add weighted Gaussians to sums of them.

    total: shape (k, n, m); axes: lateral and axial positions; weights: shape (k, M).
    """
    share(_add_gaussians, (axes[1].size - 1) // STRIP + 1, total.size, total, axes, bumps, weights)
