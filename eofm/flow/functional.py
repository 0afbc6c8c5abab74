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

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from eofm.grid import FACES, Array, Edge, Grid
from eofm.imaging.gaussian import gaussians

Roots = list[tuple[sp.csr_array, sp.csr_array]]


@dataclass(frozen=True)
class Pointwise:
    """Density of a quadratic term without derivatives, ``v . A v - 2 v . b``.

    Attributes
    ----------
    A : ndarray, shape (3, height, width)
        The entries A11, A12, A22.
    b : ndarray, shape (2, height, width)
    """

    A: Array
    b: Array

    def product(self, v: Array) -> Array:
        """``A v``, shape (2, height, width)."""
        A11, A12, A22 = self.A
        return np.stack([A11 * v[0] + A12 * v[1], A12 * v[0] + A22 * v[1]])

    def __add__(self, other: Self) -> "Pointwise":
        return Pointwise(self.A + other.A, self.b + other.b)


def data_term(grad_I: Array, I_t: Array, inside: NDArray[np.bool_]) -> Pointwise:
    """Density of ``(grad I . v + I_t)^2``, off where ``inside`` is False.

    With a background, pass ``I_t + grad I . u_bg`` for ``I_t``.
    """
    g = np.where(inside, grad_I, 0.0)
    A = np.empty((3, *I_t.shape))
    for product, i, j in zip(A, (0, 0, 1), (0, 1, 1), strict=True):
        np.multiply(g[i], g[j], out=product)
    g *= I_t
    return Pointwise(A, np.negative(g, out=g))


def speckle_term(grid: Grid, x: Array, u: Array, beta: float | Array, sigma: float) -> Pointwise:
    """Density of ``sum_i beta_i g_sigma(x, x_i) |v - u_i|^2``, eq. (def_S_u).

    Parameters
    ----------
    x, u : ndarray, shape (2, M)
        Centres of the bubbles and their displacements (less the background's), px.
    beta : float or ndarray, shape (M,)
        One weight, or one for each bubble.
    sigma : float
        Standard deviation of the Gaussians, px.
    """
    weights = np.broadcast_to(beta, x.shape[1:]) / (2 * np.pi * sigma**2)
    g = gaussians(grid.axes, x, sigma, weights * [np.ones_like(u[0]), *u])
    return Pointwise(np.stack([g[0], np.zeros_like(g[0]), g[0]]), g[1:])


def edge_term(grid: Grid, motion: dict[Edge, Array], weight: float) -> Pointwise:
    """Density of ``weight int |v - g|^2 dS`` over edges, eq. (def_B).

    Parameters
    ----------
    grid : Grid
    motion : dict of ndarray, shape (2, n)
        ``g`` at the n pixels of each edge.
    weight : float
    """
    A, b = np.zeros((3, *grid.shape)), np.zeros((2, *grid.shape))
    for edge, g in motion.items():
        depth = grid.weights[FACES[edge].component][0]
        A[[0, 2], *FACES[edge].pixels()] += weight / depth
        b[:, *FACES[edge].pixels()] += weight / depth * g
    return Pointwise(A, b)


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
    free : ndarray of bool, shape (height, width)
        False on the pixels of Gamma_1 and Gamma_2.
    smoothness : {"gradient", "bending"}
        ``R(v)``: the paper's ``int |grad v|^2``, or the integral of the squared second
        derivatives.
    """

    grid: Grid
    terms: Pointwise
    alpha: float
    free: NDArray[np.bool_]
    smoothness: str = "gradient"

    def a(self) -> sp.csr_array:
        """Matrix of ``a`` on the free pixels, first all of v1, then all of v2."""
        A11, A12, A22 = (sp.diags_array((self.grid.areas * A).ravel()) for A in self.terms.A)
        R = self.alpha * smoothness_energy(self.grid, self.smoothness)
        keep = np.flatnonzero(np.tile(self.free.ravel(), 2))
        return 2 * sp.block_array([[A11 + R, A12], [A12, A22 + R]], format="csr")[keep][:, keep]

    def b(self) -> Array:
        """Vector of ``b`` on the free pixels."""
        return 2 * (self.grid.areas * self.terms.b)[:, self.free].ravel()

    def shifted(self, p: Array) -> "Quadratic":
        """The functional of ``w = v - p``, up to a constant, for ``v = p`` where not free."""
        if not p.any():
            return self
        area, roots = self.grid.areas, ROOTS[self.smoothness](self.grid)
        smooth = [sum(P2.T @ (P2 @ c @ P1.T) @ P1 for P2, P1 in roots) / area for c in p]
        b = self.terms.b - self.terms.product(p) - self.alpha * np.stack(smooth)
        return replace(self, terms=Pointwise(self.terms.A, b))

    def rough(self, rng: np.random.Generator) -> Array:
        """Draw a functional, shape (2, height, width), with covariance ``alpha R``."""
        roots = ROOTS[self.smoothness](self.grid)

        def draw() -> Array:
            sizes = ((P2.shape[0], P1.shape[0]) for P2, P1 in roots)
            noise = (rng.standard_normal(size) for size in sizes)
            return sum(P2.T @ z @ P1 for (P2, P1), z in zip(roots, noise, strict=True))

        return np.sqrt(self.alpha) * np.stack([draw(), draw()])

    def field(self, x: Array) -> Array:
        """The field, shape (2, height, width), of a vector of free values."""
        v = np.zeros((2, *self.grid.shape))
        v[:, self.free] = x.reshape(2, -1)
        return v


def smoothness_energy(grid: Grid, smoothness: str) -> sp.coo_array:
    """Matrix of R for scalar fields with natural boundaries."""
    return sum(sp.kron(P2.T @ P2, P1.T @ P1) for P2, P1 in ROOTS[smoothness](grid))


def gradient_roots(grid: Grid) -> Roots:
    """Factors of ``R(v) = int |grad v|^2``: of each direction the matrices along x2 and x1.

    ``R = sum_k |P2_k v P1_k^T|^2`` for scalar v of shape (height, width).
    """
    (M1, D1), (M2, D2) = (_differences(grid, axis, 1) for axis in (0, 1))
    return [(M2, D1), (D2, M1)]


def bending_roots(grid: Grid) -> Roots:
    """The same of ``R(v) = int sum_jk |d_jk v|^2``."""
    (M1, D1, B1), (M2, D2, B2) = (_differences(grid, axis, 2) for axis in (0, 1))
    return [(M2, B1), (D2, np.sqrt(2) * D1), (B2, M1)]


ROOTS = {"gradient": gradient_roots, "bending": bending_roots}


def _differences(grid: Grid, axis: int, order: int) -> list[sp.csr_array]:
    """Matrices P_k along an axis with ``|P_k u|^2 = int |u^(k)|^2`` for k up to an order."""
    n, h = grid.shape[1 - axis], grid.spacing[axis]
    D, matrices = sp.eye_array(n, format="csr"), [sp.diags_array(np.sqrt(grid.weights[axis]))]
    for m in range(n - 1, n - 1 - order, -1):
        D = sp.diags_array([-np.ones(m), np.ones(m)], offsets=[0, 1], shape=(m, m + 1)) @ D / h
        matrices.append(np.sqrt(h) * D)
    return matrices
