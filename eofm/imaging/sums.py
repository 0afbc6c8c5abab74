"""Weighted sums of what is near, compiled and shared by rows or slices: averages, Gaussians.

Every row, slice or strip is computed by one thread, in one order: results do not depend on the
number of threads.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from eofm.compiled import compiled, share
from eofm.grid import Array, Mask

# Rows, and slices, that Gaussians are added to together, and rows whose sums run side by side.
STRIP, SLAB, LANES = 64, 8, 32


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
    """M Gaussians of height 1, each cut off outside of a rectangle or a box.

    Attributes
    ----------
    centres : ndarray, shape (ndim, M)
        Lateral, axial, ...
    sigma : ndarray, shape (M,)
    spans : ndarray of int, shape (ndim, 2, M)
        The first sample along each axis and the one after the last, ordered as centres are.
    """

    centres: Array
    sigma: Array
    spans: NDArray[np.intp]


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


@njit
def _sum(total, lines, at, w):
    """Write the sum of some lines, weighted, to total: four at a time, which spares its traffic."""
    total[:] = 0
    four = at.size - at.size % 4
    for k in range(0, four, 4):
        p, q, r, s = lines[at[k]], lines[at[k + 1]], lines[at[k + 2]], lines[at[k + 3]]
        a, b, c, d = w[k], w[k + 1], w[k + 2], w[k + 3]
        for j in range(total.size):
            total[j] += a * p[j] + b * q[j] + c * r[j] + d * s[j]
    for k in range(four, at.size):
        p, a = lines[at[k]], w[k]
        for j in range(total.size):
            total[j] += a * p[j]


@compiled
def _resample_slices(first, last, J, c, lateral, axial, elevational):
    slices, plane = c.reshape(c.shape[0], -1), np.empty(c.shape[1:], c.dtype)
    # Rows are turned into columns for the sums along them, so that those run side by side.
    row, columns = np.empty(c.shape[2], c.dtype), np.zeros((c.shape[2], LANES), c.dtype)
    s = np.empty(LANES, c.dtype)
    for h in range(first, last):
        _sum(plane.ravel(), slices, elevational.at[h], elevational.w[h])
        for low in range(0, J.shape[1], LANES):
            lanes = min(LANES, J.shape[1] - low)
            for i in range(lanes):
                _sum(row, plane, axial.at[low + i], axial.w[low + i])
                columns[:, i] = row
            for j in range(J.shape[2]):
                _sum(s, columns, lateral.at[j], lateral.w[j])
                for i in range(lanes):
                    J[h, low + i, j] = s[i]


def resample(J: Array, c: Array, terms: Sequence[Terms]) -> None:
    """Write to J sums of entries of c along each axis, ``terms`` being in the order of axes."""
    along = [Terms(at, np.asarray(w, J.dtype)) for at, w in terms]
    share(_resample if J.ndim == 2 else _resample_slices, len(J), J.size, J, c, *along[::-1])


@compiled
def _add_cubes(first, last, sums, f, mask, side):
    line = np.empty(f.shape[2], f.dtype)
    for p in range(first, last):
        for q in range(sums.shape[1]):
            line[:] = 0
            for h in range(p * side, min(p * side + side, f.shape[0])):
                for i in range(q * side, min(q * side + side, f.shape[1])):
                    row, used = f[h, i], mask[h, i]
                    for j in range(line.size):
                        line[j] += row[j] * used[j]
            for r in range(sums.shape[2]):
                sums[p, q, r] = line[r * side : r * side + side].sum()


@compiled
def _add_squares(first, last, sums, f, mask, side):
    line = np.empty(f.shape[1], f.dtype)
    for p in range(first, last):
        line[:] = 0
        for i in range(p * side, min(p * side + side, f.shape[0])):
            row, used = f[i], mask[i]
            for j in range(line.size):
                line[j] += row[j] * used[j]
        for r in range(sums.shape[1]):
            total = 0.0
            for j in range(r * side, min(r * side + side, line.size)):
                total += line[j]
            sums[p, r] = total


def add_squares(sums: Array, f: Array, mask: Mask, side: int) -> None:
    """Write to sums those of the pixels of a mask in squares, or cubes, of a side."""
    if side == 1:
        np.multiply(f, mask, out=sums)
    else:
        kernel = _add_squares if f.ndim == 2 else _add_cubes
        share(kernel, len(sums), f.size, sums, *map(np.ascontiguousarray, (f, mask)), side)


@compiled
def _add_gaussians(first, last, total, axes, bumps, weights):
    (x1, x2), (centres, sigma, spans) = axes, bumps
    columns, rows = spans[0], spans[1]
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


@compiled
def _add_boxes(first, last, total, axes, bumps, weights):
    (x1, x2, x3), (centres, sigma, spans) = axes, bumps
    low, high = first * SLAB, min(last * SLAB, x3.size)
    g1, g2 = np.empty(x1.size, total.dtype), np.empty(x2.size)
    for k in range(sigma.size):
        start, end, top, bottom = spans[0, 0, k], spans[0, 1, k], spans[1, 0, k], spans[1, 1, k]
        front, back = max(low, spans[2, 0, k]), min(high, spans[2, 1, k])
        if front >= back:
            continue
        factor = -0.5 / sigma[k] ** 2
        for j in range(start, end):
            g1[j] = math.exp(factor * (x1[j] - centres[0, k]) ** 2)
        for i in range(top, bottom):
            g2[i] = math.exp(factor * (x2[i] - centres[1, k]) ** 2)
        for h in range(front, back):
            g3 = math.exp(factor * (x3[h] - centres[2, k]) ** 2)
            for l in range(weights.shape[0]):
                for i in range(top, bottom):
                    height = np.float32(weights[l, k] * g3 * g2[i])
                    row = total[l, h, i]
                    for j in range(start, end):
                        row[j] += height * g1[j]


def add_gaussians(total: Array, axes: tuple[Array, ...], bumps: Bumps, weights: Array) -> None:
    """Add weighted Gaussians to sums of them.

    total: shape (k, n, m), or (k, d, n, m); axes: positions along components; weights: (k, M).
    """
    kernel, side = (_add_gaussians, STRIP) if len(axes) == 2 else (_add_boxes, SLAB)
    share(kernel, (axes[-1].size - 1) // side + 1, total.size, total, axes, bumps, weights)
