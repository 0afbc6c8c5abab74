"""Displacement of a sample as a function of its modulus, with derivative and adjoint.

Bilinear elements with incompatible modes (Taylor, Beresford and Wilson, Int. J. Numer.
Methods Eng. 10, 1976) on a uniform mesh, one relative modulus per element. They do not
lock as nu goes to 1/2 and bend well: at 2 px they are 8 times as accurate as bilinear
elements with selective reduced integration. All share one matrix, so that a new modulus
costs one banded factorisation. The truth of the phantoms comes from other elements on a
finer mesh, see `eofm.elasticity.forward`.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.linalg import cho_solve_banded, cholesky_banded

from eofm.elasticity.material import lame
from eofm.errors import InputError
from eofm.grid import FACES, Array, Edge, along_face
from eofm.settings import Sample

# Elements of a pixel, at most.
FINEST = 4
# Part of the mean diagonal that is added to a band matrix; it decides what nothing else does.
RIDGE = 1e-9


@dataclass(frozen=True)
class Elastic:
    """The forward model of a sample on elements of about ``cell`` px.

    Attributes
    ----------
    sample : Sample
        Size and Poisson ratio; the rest is not used.
    motion : dict of ndarray, shape (2, n)
        Displacement at n points that divide an edge evenly (n = 1: constant), in the unit
        of the spacing, NaN where it is free. In a direction in which no edge is held, the middle
        of the first stays where it is.
    cell : float
        Side of the elements.
    spacing : (h1, h2)
        Lateral and axial distance of the pixels.
    loose : tuple
        Those of the edges whose motion is a first guess, which `hats` may change.
    """

    sample: Sample
    motion: dict[Edge, Array]
    cell: float = 2.5
    spacing: tuple[float, ...] = (1.0, 1.0)
    loose: tuple[Edge, ...] = ()

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of elements.

        Raises
        ------
        InputError
            If they are much smaller than pixels.
        """
        lengths = ((n - 1) * h for n, h in zip(self.sample.shape, self.spacing[::-1], strict=True))
        rows, columns = (max(3, round(length / self.cell)) for length in lengths)
        if rows * columns > FINEST * math.prod(self.sample.shape):
            raise InputError(
                f"cell: {self.cell:g} px is too small to be seen in pixels; wants at least"
                f" {FINEST**-0.5:g} px"
            )
        return rows, columns

    @cached_property
    def sides(self) -> tuple[float, float]:
        """Lateral and axial side of an element."""
        (rows, columns), (h1, h2) = self.shape, self.spacing
        return (self.sample.width - 1) * h1 / columns, (self.sample.height - 1) * h2 / rows

    @cached_property
    def element_matrix(self) -> Array:
        """Stiffness matrix, shape (8, 8), of an element with E = 1.

        Nodes are ordered as (row, column) = (0, 0), (0, 1), (1, 0), (1, 1), u1 before u2. The
        four incompatible modes are eliminated, which leaves E a factor of the whole.
        """
        plain = self.sample.changed(inclusions=())
        lam, mu = (float(c) for c in lame(plain, np.zeros(2)))
        D = np.array([[lam + 2 * mu, lam, 0], [lam, lam + 2 * mu, 0], [0, 0, mu]])
        B = self._strains
        K = self.sides[0] * self.sides[1] / 4 * np.einsum("qai,ab,qbj->ij", B, D, B)
        return K[:8, :8] - K[:8, 8:] @ np.linalg.solve(K[8:, 8:], K[8:, :8])

    @property
    def _strains(self) -> Array:
        """Strains (11, 22, 2 x 12) of nodes and modes at the Gauss points, shape (4, 3, 12).

        The modes are ``1 - s^2`` and ``1 - t^2`` in both components, s and t running from -1
        to 1 along the lateral and the axial side.
        """
        t, s = np.mgrid[-1:2:2, -1:2:2].reshape(2, 4, 1) / np.sqrt(3)
        corner2, corner1 = np.mgrid[-1:2:2, -1:2:2].reshape(2, 4)
        zero = np.zeros_like(s)
        d1 = np.hstack([corner1 * (1 + corner2 * t) / 4, -2 * s, zero]) * 2 / self.sides[0]
        d2 = np.hstack([corner2 * (1 + corner1 * s) / 4, zero, -2 * t]) * 2 / self.sides[1]
        B = np.zeros((4, 3, 12))
        B[:, 0, 0::2], B[:, 1, 1::2] = d1, d2
        B[:, 2, 0::2], B[:, 2, 1::2] = d2, d1
        return B

    @cached_property
    def dofs(self) -> NDArray[np.int64]:
        """Degrees of freedom of each element, shape (elements, 8); see `_node_order`."""
        node = self._node_order
        corners = [node[:-1, :-1], node[:-1, 1:], node[1:, :-1], node[1:, 1:]]
        return (2 * np.stack(corners, axis=-1)[..., None] + np.arange(2)).reshape(-1, 8)

    @cached_property
    def prescribed(self) -> tuple[NDArray[np.bool_], Array]:
        """Which degrees of freedom are prescribed, and the values there (zero elsewhere)."""
        node = self._node_order
        fixed, values = np.zeros(2 * node.size, dtype=bool), np.zeros(2 * node.size)
        for edge, g in self.motion.items():
            on = node[FACES[edge].pixels()]
            along = along_face(g, np.linspace(0, 1, len(on)))
            for i in (0, 1):
                told = np.isfinite(along[i])
                fixed[2 * on[told] + i] = True
                values[2 * on[told] + i] = along[i, told]
        first = node[FACES[next(iter(self.motion))].pixels()]
        for i in (0, 1):
            if not fixed[i::2].any():
                fixed[2 * first[len(first) // 2] + i] = True
        return fixed, values

    def hats(self, distance: float) -> tuple[sp.csc_array, NDArray[np.int64]]:
        """Motions of the loose edges: continuous and linear between nodes a ``distance`` apart.

        Returns
        -------
        H : sparse matrix, shape (degrees of freedom, 2 q)
            Its columns are the motions along x1, then x2, that are 1 at one of q nodes.
        nodes : ndarray of int, shape (2, q)
            Row and column of those nodes.
        """
        number, held = self._node_order, np.zeros(self._node_order.shape, dtype=bool)
        for edge in set(self.motion) - set(self.loose):
            held[FACES[edge].pixels()] = True
        values: dict[tuple[int, int], float] = {}
        for edge in self.loose:
            on = number[FACES[edge].pixels()]
            length = self.sides[1 - FACES[edge].component] * (len(on) - 1)
            knots = np.linspace(0, len(on) - 1, max(2, round(length / distance)) + 1).round()
            for knot, hat in zip(knots.astype(int), np.eye(len(knots)), strict=True):
                along = np.interp(np.arange(len(on)), knots, hat)
                values |= {
                    (int(on[k]), int(on[knot])): along[k]
                    for k in np.flatnonzero(along)
                    if not held.flat[self._rank[on[k]]] and not held.flat[self._rank[on[knot]]]
                }
        places = np.array(list(values), dtype=np.int64).reshape(-1, 2)
        used, column = np.unique(places[:, 1], return_inverse=True)
        q = len(used)
        rows = np.concatenate([2 * places[:, 0], 2 * places[:, 0] + 1])
        entries = np.tile(np.array(list(values.values())), 2)
        H = sp.csc_array(
            (entries, (rows, np.concatenate([column, column + q]))), (2 * number.size, 2 * q)
        )
        return H, np.stack(np.unravel_index(self._rank[used], number.shape))

    def solve(self, log_E: Array, more: Array | None = None) -> "State":
        """Displacement for moduli ``exp(log_E)``, shape of `shape`.

        ``more``, of all degrees of freedom, is added to the motion of the edges.
        """
        E = np.exp(log_E).ravel()
        fixed, values = self.prescribed
        entry, place, shape = self._places
        entries = np.multiply.outer(E, self.element_matrix).ravel()[entry]
        band = np.bincount(place, entries, shape[0] * shape[1]).reshape(shape)
        band[0] += RIDGE * band[0].mean()
        factor = cholesky_banded(band, lower=True, check_finite=False)
        u = values.copy() if more is None else values + more
        forces = self.assemble(self.forces(E, u))
        u[~fixed] = cho_solve_banded((factor, True), -forces[~fixed], check_finite=False)
        return State(self, E, factor, u)

    def forces(self, E: Array, u: Array) -> Array:
        """Forces ``E_e K_e u`` on each element, shape (..., elements, 8)."""
        return E[:, None] * (u[..., self.dofs] @ self.element_matrix)

    def assemble(self, forces: Array) -> Array:
        """Sum at the nodes of forces on elements, shape (..., elements, 8)."""
        shape = *forces.shape[:-2], 2 * self._node_order.size
        return (self._sums @ forces.reshape(-1, self.dofs.size).T).T.reshape(shape)

    @cached_property
    def _sums(self) -> sp.csr_array:
        """Matrix of the sums at the nodes."""
        entries = np.ones(self.dofs.size), (self.dofs.ravel(), np.arange(self.dofs.size))
        return sp.csr_array(entries, (2 * self._node_order.size, self.dofs.size))

    @cached_property
    def _places(self) -> tuple[NDArray[np.intp], NDArray[np.intp], tuple[int, int]]:
        """Which entries of all element matrices go into the band matrix, where, and its shape.

        That is the lower band, as LAPACK stores it, of the degrees of freedom that are not
        prescribed.
        """
        free = ~self.prescribed[0]
        n = int(free.sum())
        number = np.where(free, np.cumsum(free) - 1, -1)[self.dofs]
        row, column = np.broadcast_arrays(number[:, :, None], number[:, None, :])
        entry = np.flatnonzero((row >= column) & (column >= 0))
        row, column = row.ravel()[entry], column.ravel()[entry]
        return entry, (row - column) * n + column, (int(np.max(row - column)) + 1, n)

    def to_pixels(self, u: Array) -> Array:
        """Cubic splines through nodal values at the pixels, shape (..., 2, height, width)."""
        S2, S1 = self._interpolation
        parts = [S2 @ u[..., i::2][..., self._node_order] @ S1.T for i in (0, 1)]
        return np.stack(parts, axis=-3)

    def from_pixels(self, f: Array) -> Array:
        """Adjoint of `to_pixels`."""
        S2, S1 = self._interpolation
        u = np.empty(2 * self._node_order.size)
        for i in (0, 1):
            u[i::2][self._node_order] = S2.T @ f[i] @ S1
        return u

    def elements_to_pixels(self, m: Array) -> Array:
        """Values of elements, shape of `shape`, bilinearly at the pixels."""
        x = [
            np.clip(np.linspace(0, k, n) - 0.5, 0, k - 1)
            for n, k in zip(self.sample.shape, self.shape, strict=True)
        ]
        rows, columns = (
            np.stack([np.interp(p, np.arange(k), e) for e in np.eye(k)], axis=1)
            for p, k in zip(x, self.shape, strict=True)
        )
        return rows @ m @ columns.T

    @cached_property
    def _node_order(self) -> NDArray[np.int64]:
        """Number of each node, shape (rows + 1, columns + 1): along the shorter side first."""
        rows, columns = (k + 1 for k in self.shape)
        if rows < columns:
            return np.arange(rows * columns).reshape(columns, rows).T
        return np.arange(rows * columns).reshape(rows, columns)

    @cached_property
    def _rank(self) -> NDArray[np.int64]:
        """Place of each numbered node in the rows of nodes."""
        return np.argsort(self._node_order, axis=None)

    @cached_property
    def _interpolation(self) -> list[Array]:
        return [
            make_interp_spline(np.linspace(0, n - 1, k + 1), np.eye(k + 1))(np.arange(n))
            for n, k in zip(self.sample.shape, self.shape, strict=True)
        ]


@dataclass(frozen=True)
class State:
    """A displacement ``u`` (nodal values) and what its derivative needs."""

    model: Elastic
    E: Array
    factor: Array
    u: Array

    def derivative(self, d: Array, more: Array | None = None) -> Array:
        """Change of ``u`` at the pixels for a change ``d`` of log E, or for a stack of them.

        To first order: ``K du = - sum_e d_e E_e K_e u``, where the edges' motion changes by
        ``more``, if given.
        """
        f = -d.reshape(*d.shape[:-2], -1, 1) * self._forces
        if more is None:
            return self.model.to_pixels(self._inverse(self.model.assemble(f)))
        f -= self.model.forces(self.E, more)
        return self.model.to_pixels(more + self._inverse(self.model.assemble(f)))

    def adjoint(self, f: Array) -> tuple[Array, Array]:
        """Adjoint of `derivative` for ``f`` of shape (2, height, width).

        Returns
        -------
        d : ndarray, of the shape of the elements
        more : ndarray
            Of all degrees of freedom; it means something on the edges alone.
        """
        f = self.model.from_pixels(f)
        w = self._inverse(f)
        d = -(self._forces * w[self.model.dofs]).sum(1).reshape(self.model.shape)
        return d, f - self.model.assemble(self.model.forces(self.E, w))

    @cached_property
    def _forces(self) -> Array:
        return self.model.forces(self.E, self.u)

    def _inverse(self, f: Array) -> Array:
        free = ~self.model.prescribed[0]
        w = np.zeros_like(f)
        w[..., free] = cho_solve_banded((self.factor, True), f[..., free].T, check_finite=False).T
        return w
