"""Minimise F, eq. (def_F), among cubic splines.

Where the smoothness term forbids detail finer than a few pixels, splines with knots
every few px hold the same minimiser with a tenth of the unknowns and more, and a banded
Cholesky factorisation takes the place of the sparse one. The factor is kept, since it
also yields samples of the posterior (`Minimum.sample`).
"""

from dataclasses import dataclass
from functools import cached_property
from math import ceil

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs

from eofm.config import Edge
from eofm.functional import SMOOTHNESS, Grid, Pointwise

Array = NDArray[np.float64]

DEGREE = 3
# Part of the mean diagonal that is added to it; it decides what neither data nor edges do.
RIDGE = 1e-9
ENDS: dict[Edge, tuple[int, int]] = {
    "top": (0, 0),
    "bottom": (0, -1),
    "left": (1, 0),
    "right": (1, -1),
}


def spline_matrix(n: int, h: float, knots: float) -> sp.csr_array:
    """Values at ``n`` samples ``h`` px apart of cubic splines with knots every ``knots`` px.

    The end knots are repeated, so that only the first and the last spline are not zero
    on the ends. Knots are never closer than samples.
    """
    pieces = max(1, ceil((n - 1) * h / max(knots, h) - 1e-9))
    inner = np.linspace(0, n - 1, pieces + 1)
    t = np.concatenate([np.repeat(inner[0], DEGREE), inner, np.repeat(inner[-1], DEGREE)])
    return sp.csr_array(BSpline.design_matrix(np.arange(n, dtype=float), t, DEGREE))


@dataclass(frozen=True)
class Splines:
    """Fields whose components are cubic splines, sampled on the pixels of a grid.

    Attributes
    ----------
    grid : Grid
    knots : float
        Distance of the knots, px.
    zero_edges : tuple of {"top", "bottom", "left", "right"}
        Where ``v = 0``.
    smoothness : {"gradient", "bending"}
        ``R(v)``, see `eofm.functional.Quadratic`.
    """

    grid: Grid
    knots: float
    zero_edges: tuple[Edge, ...] = ()
    smoothness: str = "bending"

    def minimise(self, terms: Pointwise, alpha: float) -> "Minimum":
        """Minimiser of F with these data and speckle terms and ``alpha R``."""
        w1, w2 = self.grid.weights
        area = np.outer(w2, w1)
        P, R = self.matrix, alpha * self._smoothness
        A11, A12, A22 = (P.T @ sp.diags_array((area * A).ravel()) @ P for A in terms.A)
        # The components of one coefficient stay together, which keeps the band narrow.
        A = sum(
            sp.kron(block, np.eye(2)[[i]].T @ np.eye(2)[[j]])
            for block, i, j in ((A11 + R, 0, 0), (A12, 0, 1), (A12, 1, 0), (A22 + R, 1, 1))
        )
        b = P.T @ (area * terms.b).reshape(2, -1).T
        factor = cholesky_banded(band(A), lower=True)
        return Minimum(self, factor, cho_solve_banded((factor, True), b.ravel()))

    def field(self, c: Array) -> Array:
        """Return the field, shape (2, height, width), of coefficients."""
        return (self.matrix @ c.reshape(-1, 2)).T.reshape(2, *self.grid.shape)

    @cached_property
    def matrix(self) -> sp.csr_array:
        """Values on all pixels of the splines that are free, the shorter axis first."""
        return sp.kron(*self._axes, format="csr")[:, self._order]

    @cached_property
    def _axes(self) -> list[sp.csr_array]:
        axes = []
        for axis, (n, h) in enumerate(zip(self.grid.shape, self.grid.spacing[::-1], strict=True)):
            B = spline_matrix(n, h, self.knots)
            kept = np.ones(B.shape[1], dtype=bool)
            for edge in self.zero_edges:
                if ENDS[edge][0] == axis:
                    kept[ENDS[edge][1]] = False
            axes.append(B[:, np.flatnonzero(kept)])
        return axes

    @cached_property
    def _order(self) -> NDArray[np.int64]:
        n2, n1 = (B.shape[1] for B in self._axes)
        order = np.arange(n2 * n1).reshape(n2, n1)
        return (order.T if n2 < n1 else order).ravel()

    @cached_property
    def _smoothness(self) -> sp.csr_array:
        R = SMOOTHNESS[self.smoothness](self.grid).tocsr()
        return self.matrix.T @ R @ self.matrix


@dataclass(frozen=True)
class Minimum:
    """A minimiser of F among splines, with the Cholesky factor of its matrix ``a / 2``."""

    space: Splines
    factor: Array
    c: Array

    @property
    def v(self) -> Array:
        """The minimiser on the pixels, shape (2, height, width)."""
        return self.space.field(self.c)

    def sample(self, rng: np.random.Generator) -> Array:
        """Draw a field from the normal distribution with covariance ``(a / 2)^-1``.

        Times the standard deviation of the noise, this is the deviation of a sample of
        the posterior from its mean (the minimiser).
        """
        z, _ = dtbtrs(self.factor, rng.standard_normal((len(self.c), 1)), uplo="L", trans="T")
        return self.space.field(z)


def band(A: sp.sparray) -> Array:
    """Lower band of a symmetric matrix, as LAPACK stores it."""
    A = sp.coo_array(sp.csr_array(A))
    row, column = A.coords
    lower = row >= column
    row, column = row[lower], column[lower]
    band = np.zeros(((row - column).max() + 1, A.shape[0]))
    band[row - column, column] = A.data[lower]
    band[0] += RIDGE * band[0].mean()
    return band
