"""The functional F of the paper, its forms a and b, on the pixel grid.

Eq. (def_F) is ``F(v) = 1/2 a(v, v) - b(v) + c`` with, eq. (def_a_b_c),

    a(u, v) = 2 int (grad I . u)(grad I . v) + alpha grad u : grad v
                    + beta sum_i g_sigma(x, x_i) u . v
    b(v)    = 2 int beta sum_i g_sigma(x, x_i)(u_i - u_bg(x_i)) . v
                    - (I_t + grad I . u_bg)(grad I . v)

Functions are bilinear on the cells between pixel centres and integrals are taken with
the trapezoidal rule in each cell: second order, and every term without derivatives of
``u`` becomes one symmetric 2 x 2 matrix per pixel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from itertools import combinations_with_replacement
from itertools import product as tuples
from math import factorial, prod, sqrt
from typing import Any, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import DTypeLike

from eofm.flow.operator import Operator, axis_tables
from eofm.flow.stencils3 import product
from eofm.grid import FACES, Array, Edge, Grid, Mask
from eofm.imaging.gaussian import gaussians

Roots = list[tuple[sp.csr_array, ...]]

# Order of the derivatives in R.
ORDERS = {"gradient": 1, "bending": 2}


def pairs(ndim: int) -> list[tuple[int, int]]:
    """Components of the entries of a symmetric matrix as they are stored.

    11, 12, 22, or 11, 12, 13, 22, 23, 33.
    """
    return list(combinations_with_replacement(range(ndim), 2))


def unit(v: Array) -> Array:
    """Entries of the identity, to be added to those of matrices that act on a field."""
    entries = [float(i == j) for i, j in pairs(len(v))]
    return np.reshape(np.asarray(entries, v.dtype), (-1, *[1] * len(v)))


@dataclass(frozen=True)
class Pointwise:
    """Density of a quadratic term without derivatives, ``v . A v - 2 v . b``.

    Attributes
    ----------
    A : ndarray, shape (3, height, width) or (6, depth, height, width)
        The entries of a symmetric matrix, see `pairs`.
    b : ndarray, shape (ndim, ...)
    """

    A: Array
    b: Array

    def product(self, v: Array) -> Array:
        """``A v``, of the shape of v."""
        q = np.zeros_like(v)
        for A, (i, j) in zip(self.A, pairs(len(v)), strict=True):
            q[i] += A * v[j]
            if i != j:
                q[j] += A * v[i]
        return q

    def __add__(self, other: Self) -> "Pointwise":
        return Pointwise(self.A + other.A, self.b + other.b)

    def times(self, factor: Array) -> "Pointwise":
        """The same, multiplied by a factor at each pixel."""
        return Pointwise(factor * self.A, factor * self.b)


def isotropic(a: Array, b: Array) -> Pointwise:
    """Density of ``a v . v - 2 v . b``, for ``a`` of the grid's shape."""
    A = [a if i == j else np.zeros_like(a) for i, j in pairs(len(b))]
    return Pointwise(np.stack(A), b)


def data_term(grad_I: Array, I_t: Array, inside: Mask) -> Pointwise:
    """Density of ``(grad I . v + I_t)^2``, off where ``inside`` is False.

    With a background, pass ``I_t + grad I . u_bg`` for ``I_t``.
    """
    g = np.where(inside, grad_I, 0.0)
    entries = pairs(len(g))
    A = np.empty((len(entries), *I_t.shape), g.dtype)
    for entry, (i, j) in zip(A, entries, strict=True):
        np.multiply(g[i], g[j], out=entry)
    g *= I_t
    return Pointwise(A, np.negative(g, out=g))


def speckle_term(grid: Grid, x: Array, u: Array, beta: float | Array, sigma: float) -> Pointwise:
    """Density of ``sum_i beta_i g_sigma(x, x_i) |v - u_i|^2``, eq. (def_S_u).

    Parameters
    ----------
    x, u : ndarray, shape (ndim, M)
        Centres of the bubbles and their displacements (less the background's), px.
    beta : float or ndarray, shape (M,)
        One weight, or one for each bubble.
    sigma : float
        Standard deviation of the Gaussians, px.

    Notes
    -----
    The factor of a Gaussian is the paper's, ``1 / (2 pi sigma^2)``, in volumes as well: a slice
    through bubbles has the term of an image of them. So ``beta`` has no unit, as ``|grad I|^2``
    has none, and bubbles as far apart say as much beside it. Of an integral of 1, which would take
    a third sigma, they would say a tenth of that.
    """
    weights = np.broadcast_to(beta, x.shape[1:]) / (2 * np.pi * sigma**2)
    g = gaussians(grid.axes, x, sigma, weights * [np.ones_like(u[0]), *u])
    return isotropic(g[0], g[1:])


def hold_edges(terms: Pointwise, grid: Grid, motion: Mapping[Edge, Array], weight: float) -> None:
    """Add the density of ``weight int |v - g|^2 dS`` over edges or faces, eq. (def_B), in place.

    Parameters
    ----------
    terms : Pointwise
    grid : Grid
    motion : mapping of ndarray, shape (ndim, ...)
        ``g`` at the pixels of each edge, NaN where a component is free.
    weight : float
    """
    diagonal = [entry for entry, (i, j) in zip(terms.A, pairs(grid.ndim), strict=True) if i == j]
    for edge, g in motion.items():
        face = FACES[edge]
        at, density = face.pixels(grid.ndim), weight / grid.weights[face.component][0]
        for a, b, component in zip(diagonal, terms.b, g, strict=True):
            a[at] += density * np.isfinite(component)
            b[at] += density * np.nan_to_num(component)


@dataclass(frozen=True)
class Quadratic:
    """The functional on a grid: pointwise terms, smoothness, and where ``v = 0``.

    Attributes
    ----------
    grid : Grid
    terms : Pointwise
        Data and speckle term.
    alpha : float
        Weight of the smoothness term.
    free : ndarray of bool, of the grid's shape
        False on the pixels of Gamma_1 and Gamma_2.
    smoothness : {"gradient", "bending"}
        ``R(v)``: the paper's ``int |grad v|^2``, or the integral of the squared second
        derivatives.
    """

    grid: Grid
    terms: Pointwise
    alpha: float
    free: Mask
    smoothness: str = "gradient"

    def a(self) -> sp.csr_array:
        """Matrix of ``a`` on the free pixels, first all of v1, then all of v2 and so on."""
        n = self.grid.ndim
        R = self.alpha * smoothness_energy(self.grid, self.smoothness)
        blocks: list[list[Any]] = [[None] * n for _ in range(n)]
        for A, (i, j) in zip(self.terms.A, pairs(n), strict=True):
            blocks[i][j] = blocks[j][i] = sp.diags_array((self.grid.areas * A).ravel())
            if i == j:
                blocks[i][i] = blocks[i][i] + R
        keep = np.flatnonzero(np.tile(self.free.ravel(), n))
        return 2 * sp.block_array(blocks, format="csr")[keep][:, keep]

    def b(self) -> Array:
        """Vector of ``b`` on the free pixels."""
        return 2 * (self.grid.areas * self.terms.b)[:, self.free].ravel()

    def operator(self) -> Operator:
        """``K = a / 2`` without a matrix, in the precision of the terms.

        Factors of the smoothness term are in double precision, so that products are summed in
        it: the energy of smooth motions would else be lost in rounding.
        """
        precision = np.result_type(self.terms.A, self.terms.b, np.float32)
        A = np.require(self.terms.A, precision, ["C", "W"])
        free = np.require(self.free, np.bool_, ["C", "W"])
        bending = self.smoothness == "bending"
        axes = axis_tables(self.grid.shape, self.grid.spacing, self.alpha, bending)
        return Operator(A, np.empty((0, *self.grid.shape), precision), free, axes, bending)

    def shifted(self, p: Array) -> "Quadratic":
        """The functional of ``w = v - p``, up to a constant, for ``v = p`` where not free."""
        if not p.any():
            return self
        if self.grid.ndim == 3:
            return self._shifted_volume(p)
        b = self.terms.product(p)
        np.subtract(self.terms.b, b, out=b)
        b -= self.smoothed(p)
        return replace(self, terms=Pointwise(self.terms.A, b))

    def smoothed(self, v: Array) -> Array:
        """What ``alpha R`` asks of a field: its density, of the shape of ``terms.b``.

        In double precision: factors that are rounded would ask something of an affine field, by
        far more than images ask of it, where the sides of voxels are not alike.
        """
        squares, force = smoothness_squares(self.grid, self.smoothness), np.empty_like(v)
        for target, c in zip(force, v, strict=True):
            smooth = sum(_apply(Q, c.astype(np.float64, copy=False)) for Q in squares)
            np.multiply(self.alpha, smooth / self.grid.areas, out=target)
        return force

    def _shifted_volume(self, p: Array) -> "Quadratic":
        # The same for a volume, where sparse matrices would take ten times as long.
        K = self.operator()
        b, border = np.empty_like(self.terms.b, K.A.dtype), [(0, 0), (2, 2), (2, 2), (2, 2)]
        product(b, np.pad(p.astype(b.dtype, copy=False), border), K._replace(free=self.free | True))
        for component, weights in enumerate(self.grid.weights):
            b /= weights.astype(b.dtype).reshape(-1, *[1] * component)
        return replace(self, terms=Pointwise(self.terms.A, np.subtract(self.terms.b, b, out=b)))

    def rough(self, rng: np.random.Generator) -> Array:
        """Draw a functional, of the shape of ``terms.b``, with covariance ``alpha R``."""
        roots, dtype = smoothness_roots(self.grid, self.smoothness), self.terms.b.dtype

        def draw() -> Array:
            shapes = ([M.shape[0] for M in P[::-1]] for P in roots)
            noise = (signs(rng, shape, dtype) for shape in shapes)
            parts = (_apply([M.T for M in P], z) for P, z in zip(roots, noise, strict=True))
            return sqrt(self.alpha) * reduce(np.add, parts)

        return np.stack([draw() for _ in range(self.grid.ndim)])

    def field(self, x: Array) -> Array:
        """The field, of the shape of ``terms.b``, of a vector of free values."""
        v = np.zeros_like(self.terms.b)
        v[:, self.free] = x.reshape(len(v), -1)
        return v


def signs(rng: np.random.Generator, shape: Sequence[int], dtype: DTypeLike) -> Array:
    """White noise of variance 1 in a tenth of the time of normal numbers."""
    noise = rng.integers(2, size=shape, dtype=np.int8).astype(dtype)
    noise *= 2
    noise -= 1
    return noise


def smoothness_energy(grid: Grid, smoothness: str) -> sp.coo_array:
    """Matrix of R for scalar fields with natural boundaries."""
    return sum(reduce(sp.kron, Q[::-1]) for Q in smoothness_squares(grid, smoothness))


@lru_cache(8)
def smoothness_squares(grid: Grid, smoothness: str) -> Roots:
    """Terms of R: for each derivative a matrix along each component, whose products they are."""
    return [tuple((M.T @ M).tocsr() for M in P) for P in smoothness_roots(grid, smoothness)]


@lru_cache(8)
def smoothness_roots(grid: Grid, smoothness: str) -> Roots:
    """Factors of R: for each derivative a matrix along each component.

    ``R(v) = int sum |d^k v|^2`` over all derivatives of one order, each as often as it stands
    among those with their indices in any order: 1 for ``int |grad v|^2``, 2 for the bending
    energy ``int sum_jk |d_jk v|^2``. It is the sum of the squares of the matrices' products with v.
    """
    order = ORDERS[smoothness]
    along = [_differences(grid, c, order) for c in range(grid.ndim)]
    derivatives = [k for k in tuples(range(order, -1, -1), repeat=grid.ndim) if sum(k) == order]
    roots = []
    for k in derivatives:
        copies = factorial(order) / prod(map(factorial, k))
        first, *others = (matrices[m] for matrices, m in zip(along, k, strict=True))
        roots.append((np.sqrt(copies) * first, *others))
    return roots


def _apply(matrices: Sequence[sp.sparray], f: Array) -> Array:
    """Product of a scalar field with a matrix along each component."""
    for axis, matrix in enumerate(reversed(matrices)):
        M = matrix.astype(f.dtype, copy=False)
        lines = np.moveaxis(f, axis, 0)
        lines = (M @ lines.reshape(len(lines), -1)).reshape(-1, *lines.shape[1:])
        f = np.moveaxis(lines, 0, axis)
    return f


def _differences(grid: Grid, component: int, order: int) -> list[sp.csr_array]:
    """Matrices P_k along a component with ``|P_k u|^2 = int |u^(k)|^2`` for k up to an order."""
    n, h = grid.shape[grid.ndim - 1 - component], grid.spacing[component]
    D = sp.eye_array(n, format="csr")
    matrices = [sp.diags_array(np.sqrt(grid.weights[component]), format="csr")]
    for m in range(n - 1, n - 1 - order, -1):
        D = sp.diags_array([-np.ones(m), np.ones(m)], offsets=[0, 1], shape=(m, m + 1)) @ D / h
        matrices.append(np.sqrt(h) * D)
    return matrices
