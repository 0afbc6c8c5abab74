"""The coarsest grid of :mod:`eofm.flow.hierarchy`, on which K is a matrix and is factorised."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from eofm.flow.functional import pairs
from eofm.flow.operator import Operator, Real, axis_tables, inner
from eofm.grid import Array
from eofm.threads import serial

Indices = NDArray[np.intp]
Product = Callable[..., Any]


class Coarsest:
    """The Cholesky factor of K, a band matrix, whose columns come from products with combs.

    Parameters
    ----------
    operator : Operator
    spacing : tuple of float
    alpha : float
    product : callable
        Of the grid's dimension, see :func:`eofm.flow.stencils.product`.
    pointwise : ndarray
        The :func:`pointwise_band` of the operator.
    precision : dtype
        Of the field that is given back.
    """

    def __init__(
        self,
        operator: Operator,
        spacing: tuple[float, ...],
        alpha: float,
        product: Product,
        pointwise: Array,
        precision: DTypeLike = np.float64,
    ) -> None:
        free, bending = operator.free, operator.bending
        self.axes, number = numbers(free.shape)
        self.x = np.zeros((free.ndim, *(n + 4 for n in free.shape)), precision)
        # The smoothness term is that of all operators on the grid but for alpha, and needs more
        # combs: the pointwise term couples neighbours at most.
        band = alpha * _smoothness(free.shape, spacing, bending, product)
        if not free.all():
            held = np.zeros(number.size, dtype=bool)
            held[number[:, ~free]] = True
            for k, diagonal in enumerate(band):
                diagonal[held | np.roll(held, -k)] = 0
            band[0, held] = 1.0
        band += pointwise
        # The larger bands of volumes BLAS would share among threads, with other sums.
        factorise = cholesky_banded if free.ndim == 2 else serial(cholesky_banded)
        self.factor = factorise(band, lower=True, check_finite=False)

    def correct(self, b: Real, visits: int = 1) -> Real:
        """Field K^-1 b."""
        order = b.transpose(self.axes)
        solution = cho_solve_banded((self.factor, True), order.ravel(), check_finite=False)
        inner(self.x).transpose(self.axes)[...] = solution.reshape(order.shape)
        return self.x


def pointwise_band(operator: Operator, spacing: tuple[float, ...], product: Product) -> Array:
    """Band of an operator but for the smoothness term."""
    flat = axis_tables(operator.shape, spacing, 0.0, operator.bending)
    band = np.zeros(_band(operator.shape, operator.bending))
    _add(band, operator.rounded(np.float64)._replace(axes=flat), product, 1)
    return band


@lru_cache(16)
def _smoothness(
    shape: tuple[int, ...], spacing: tuple[float, ...], bending: bool, product: Product
) -> Array:
    """Band of the smoothness term of a grid with alpha = 1."""
    A, G = np.zeros((len(pairs(len(shape))), *shape)), np.empty((0, *shape))
    axes = axis_tables(shape, spacing, 1.0, bending)
    band = np.zeros(_band(shape, bending))
    K = Operator(A, G, np.ones(shape, dtype=np.bool_), axes, bending)
    _add(band, K, product, _reach(bending))
    return band


def _add(band: Array, K: Operator, product: Product, reach: int) -> None:
    """Add K, which couples nodes so far from each other, from its products with combs."""
    _, number = numbers(K.shape)
    field, q = np.zeros((len(number), *(n + 4 for n in K.shape))), np.empty(number.shape)
    nodes = inner(field)
    for comb in combs(K.shape, reach):
        nodes[comb.teeth] = K.free[comb.teeth[1:]]
        product(q, field, K)
        nodes[comb.teeth] = 0
        band.ravel()[comb.places] += q.ravel()[comb.entries]


class Comb(NamedTuple):
    """A field that is 1 on nodes so far apart that the stencils around them are disjoint.

    Attributes
    ----------
    teeth : tuple of int and slices
        Where it is 1.
    entries, places : ndarray
        Entries of its product with K, and where in the band of K they stand.
    """

    teeth: tuple[Any, ...]
    entries: Indices
    places: Indices


@lru_cache(16)
def combs(shape: tuple[int, ...], reach: int) -> list[Comb]:
    """Those that tell all of an operator that couples nodes so far from each other."""
    _, number = numbers(shape)
    step = 2 * reach + 1
    nodes = np.ogrid[*(slice(n) for n in shape)]
    found = []
    for c, *first in np.ndindex(len(shape), *[step] * len(shape)):
        tooth = [i + (k - i + reach) % step - reach for i, k in zip(nodes, first, strict=True)]
        column = number[c][*(t.clip(0, n - 1) for t, n in zip(tooth, shape, strict=True))]
        lower = number >= column
        for t, n in zip(tooth, shape, strict=True):
            lower &= (t >= 0) & (t < n)
        column = np.broadcast_to(column, number.shape)[lower]
        places = (number[lower] - column) * number.size + column
        teeth = (c, *(slice(k, None, step) for k in first))
        found.append(Comb(teeth, np.flatnonzero(lower), places))
    return found


@lru_cache(16)
def numbers(shape: tuple[int, ...]) -> tuple[tuple[int, ...], Indices]:
    """Order of the axes of functionals, and the number of each entry in it.

    Unknowns are ordered by the longest side of the grid, then the shorter ones, then the
    component: the band is narrow.
    """
    sides = sorted(range(len(shape)), key=lambda axis: -shape[axis])
    axes = (*(axis + 1 for axis in sides), 0)
    number = np.empty((len(shape), *shape), dtype=np.intp)
    ordered = number.transpose(axes)
    ordered[...] = np.arange(number.size).reshape(ordered.shape)
    return axes, number


def _band(shape: tuple[int, ...], bending: bool) -> tuple[int, int]:
    """Shape of K's diagonals from the main one down."""
    across = (*sorted(shape, reverse=True)[1:], len(shape))
    farthest = sum(math.prod(across[k:]) for k in range(len(across)))
    return _reach(bending) * farthest + len(shape), math.prod(shape) * len(shape)


def _reach(bending: bool) -> int:
    """Nodes on either side that the smoothness term couples."""
    return 2 if bending else 1
