"""The operator K of a functional on one grid, without its matrix, and how grids lie in each other.

It is what :mod:`eofm.flow.stencils` and :mod:`eofm.flow.stencils3` multiply with.
"""

from functools import lru_cache
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from eofm.grid import Array, Mask

# An array of single or double precision.
Real = NDArray[Any]

# Rows of the table of an axis: the diagonal of M, bands -2 to 2 of S and -1 to 1 of T, and the
# sums over each row of |S| and |T|. One array holds them all: compilers vectorise loops over rows
# of one array, but give up where they have to compare the addresses of many.
M, SA, SB, SC, SD, SE, TB, TC, TD, S_SUM, T_SUM = range(11)


def axis_table(n: int, h: float, alpha: float, bending: bool) -> Array:
    """Factors along one axis of alpha R, shape (11, n).

    That is ``M2 x S1 + S2 x M1 + T2 x T1`` or, in volumes, ``M3 x M2 x S1 + M3 x T2 x T1`` and what
    the other orders of the axes make of it. M holds the trapezoidal weights. S is
    ``alpha int u' v'`` and T zero for the gradient; for bending S is ``alpha int u'' v''`` and T
    is ``sqrt(2 alpha) int u' v'``.
    """

    def bands(difference: tuple[float, ...]) -> Array:
        order = len(difference) - 1
        S = np.zeros((5, n))
        for p, cp in enumerate(difference):
            for q, cq in enumerate(difference):
                S[2 + q - p, p : n - order + p] += cp * cq * h ** (1 - 2 * order)
        return S

    X = np.zeros((11, n))
    X[M] = h
    X[M, [0, -1]] /= 2
    X[SA : SE + 1] = alpha * bands((1.0, -2.0, 1.0) if bending else (-1.0, 1.0))
    if bending:
        X[TB : TD + 1] = np.sqrt(2 * alpha) * bands((-1.0, 1.0))[1:4]
    X[S_SUM], X[T_SUM] = abs(X[SA : SE + 1]).sum(0), abs(X[TB : TD + 1]).sum(0)
    return X


@lru_cache(64)
def axis_tables(
    shape: tuple[int, ...], spacing: tuple[float, ...], alpha: float, bending: bool
) -> tuple[Array, ...]:
    """Factors of the smoothness term of a grid, along each component, which all share."""
    sides = zip(shape[::-1], spacing, strict=True)
    return tuple(axis_table(n, float(h), alpha, bending) for n, h in sides)


class Operator(NamedTuple):
    """K on one grid: the sum of a pointwise term and of the smoothness term.

    On coarse grids the pointwise term may couple neighbouring nodes p, q too. Its energy is
    ``sum_p a_p u_p . A_p u_p - sum_pq (u_p - u_q) . G_pq (u_p - u_q)``, where ``a_p`` is the
    area of a node, and ``a_p A_p`` is the sum over each row of blocks.

    Attributes
    ----------
    A : ndarray, shape (3, n, m) or (6, l, n, m)
        Entries of the symmetric blocks ``A_p``, per area, see :func:`eofm.flow.functional.pairs`.
    G : ndarray, shape (12, n, m), (42, l, n, m) or (0, ...)
        Blocks ``G_pq``, if any; on the finest grid there are none. In images they couple a node
        and the next ones in the directions ``stencils.AHEAD``. In volumes those of a cell between
        nodes that differ along the same axes are equal: there are seven for each cell, in
        the order of the numbers with a bit for each component. Zero where there is no such node.
    free : ndarray of bool, shape (n, m) or (l, n, m)
        False where K u is not wanted.
    axes : tuple of ndarray
        Factors of the smoothness term along each component, see :func:`axis_table`.
    bending : bool
        Which smoothness they are made for.
    """

    A: Real
    G: Real
    free: Mask
    axes: tuple[Real, ...]
    bending: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the grid."""
        return self.free.shape

    def rounded(self, precision: DTypeLike) -> Self:
        """The same in another precision."""
        A, G = (array.astype(precision, copy=False) for array in (self.A, self.G))
        axes = tuple(axis.astype(precision, copy=False) for axis in self.axes)
        return type(self)(A, G, self.free, axes, self.bending)


class Between(NamedTuple):
    """Where the n nodes of an axis lie among fewer ones that share the ends.

    Node i lies between the coarse nodes J[i] and J[i] + 1, a part t[i] of their distance from
    the first.

    Attributes
    ----------
    J : ndarray of int, shape (n,)
    t : ndarray, shape (n,)
    """

    J: NDArray[np.intp]
    t: Real

    @classmethod
    def of(cls, n: int, coarse: int) -> Self:
        """That of n nodes among a coarse number of them."""
        position = np.arange(n) * (coarse - 1) / (n - 1)
        J = np.minimum(position.astype(np.intp), coarse - 2)
        return cls(J, position - J)

    def rounded(self, precision: DTypeLike) -> Self:
        """The same in another precision."""
        return type(self)(self.J, self.t.astype(precision, copy=False))


# Along each component.
Transfer = tuple[Between, ...]


def inner(field: Real) -> Real:
    """The values of a field without its border of zeros."""
    return field[:, *[slice(2, -2)] * (field.ndim - 1)]
