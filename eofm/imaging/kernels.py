"""Coefficients of splines and their slopes, compiled and shared by rows or slices.

Coefficients of cubic splines have 3 entries more than the image or volume along every axis: those
of pixel (i, j) stand at (i + 1, j + 1), framed by one entry before and two after that continue
them, here as in a mirror. So the spline's value anywhere in it is a sum over 4 x 4 coefficients,
or 4 x 4 x 4, without questions at the edges.

Every row, slice or strip is computed by one thread, in one order: results do not depend on the
number of threads.
"""

import math

import numpy as np

from eofm.compiled import compiled, share
from eofm.grid import Array

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
