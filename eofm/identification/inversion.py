"""The functional of the identification on elements, and its minimiser."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.sparse.linalg import LinearOperator, cg

from eofm.elasticity.sensitivity import Elastic, State
from eofm.grid import Array
from eofm.settings import Identification

# Contrasts beyond 10 cannot be told apart: the inclusion is rigid, or empty.
LARGEST = np.log(30)
# Part of the prior's mean diagonal that pulls log E to 0: stiffness has no absolute scale
# where all motions are prescribed.
ANCHOR = 1e-6
# Slope of log E at which an outline has half of the prior's weight, 1/px.
SLOPE = 0.01

# Called after each Gauss-Newton step with gamma, the number of the step and its gain.
Report = Callable[[float, int, float], object]


@dataclass(frozen=True)
class Inversion:
    """The linearised images and the forward model.

    What is sought is a vector ``z``: m of each element, then the motion of the loose edges at
    nodes, as a multiple of what it may be off by.

    Attributes
    ----------
    model : Elastic
    correction : ndarray, shape (2, height, width)
        What is added to the model's displacement.
    g : ndarray, shape (2, height, width)
    r : ndarray, shape (height, width)
        A displacement u leaves ``r + g . u`` of the images, in deviations of their noise.
    epsilon : float
    edges : sparse matrix, shape (degrees of freedom, unknowns of the edges)
        Motions of the nodes, one standard deviation each.
    weights : ndarray, shape (elements,), or 1
        Of the total variation in each element.
    """

    model: Elastic
    correction: Array
    g: Array
    r: Array
    epsilon: float
    edges: sp.csc_array
    weights: Array | float = 1.0

    def relaxed(self, z: Array) -> "Inversion":
        """Return the same with less weight of the prior where ``z`` has outlines.

        Total variation takes off the contrast of what it outlines. Weights ``1 / (1 + |grad m|
        / SLOPE)`` do so less, and a few rounds of them approach a prior that counts outlines
        and not their height (Candes, Wakin and Boyd, J. Fourier Anal. Appl. 14, 2008).
        """
        m = z[: self.elements]
        slopes = np.sqrt(sum((D @ m) ** 2 for D in self.gradients))
        return replace(self, weights=1 / (1 + slopes / SLOPE))

    @property
    def elements(self) -> int:
        """Number of elements."""
        return self.model.shape[0] * self.model.shape[1]

    def m(self, z: Array) -> Array:
        """The part of ``z``, or of a stack of them, that belongs to elements, in their shape."""
        return z[..., : self.elements].reshape(*z.shape[:-1], *self.model.shape)

    def start(self, m: Array | float = 0.0) -> Array:
        """``z`` of a modulus whose edges move as first guessed."""
        return np.r_[np.broadcast_to(m, self.model.shape).ravel(), np.zeros(self.edges.shape[1])]

    def state(self, z: Array) -> State:
        """Elastic state of ``z``."""
        more = self.edges @ z[self.elements :] if self.edges.shape[1] else None
        return self.model.solve(self.log_E(z), more)

    def log_E(self, z: Array) -> Array:
        """Logarithm of the modulus of each element."""
        log_E: Array = LARGEST * np.tanh(self.m(z) / LARGEST)
        return log_E

    def u(self, state: State) -> Array:
        """Its displacement; the error of the mesh for E = 1 is taken off, px."""
        return self.model.to_pixels(state.u) + self.correction

    def cost(self, z: Array, state: State, gamma: float) -> float:
        """Value of the functional."""
        m = z[: self.elements]
        fit = (self.left(state) ** 2).sum()
        size = np.sqrt(sum((D @ m) ** 2 for D in self.gradients) + self.epsilon**2)
        return float(
            fit
            + 2 * gamma * self.area * (self.weights * size).sum()
            + (z[self.elements :] ** 2).sum()
        )

    def improve(self, z: Array, state: State, gamma: float, damping: float) -> Array:
        """Damped Gauss-Newton step from ``z``."""
        prior = gamma * self.prior(self.m(z))
        right = self.back(z, state, self.misfit(state))
        right[: self.elements] -= prior @ z[: self.elements]
        right[self.elements :] -= z[self.elements :]
        return self.solver(z, state, prior + damping * sp.eye_array(self.elements))(right)

    def left(self, state: State) -> Array:
        """What the displacement leaves of the images, shape (height, width)."""
        return self.r + self.seen(self.u(state))

    def seen(self, u: Array) -> Array:
        """Change of what is left for a change of u, or for a stack of them."""
        return (self.g * u).sum(-3)

    def misfit(self, state: State) -> Array:
        """Half the negative slope of the data term in u, shape (2, height, width)."""
        return -self.g * self.left(state)

    def forth(self, z: Array, state: State, d: Array) -> Array:
        """Change of u at the pixels for a change ``d`` of ``z``, or for a stack of them."""
        more = (self.edges @ d[..., self.elements :].T).T if self.edges.shape[1] else None
        return state.derivative(slope(self.m(z)) * self.m(d), more)

    def back(self, z: Array, state: State, f: Array) -> Array:
        """Adjoint of `forth`."""
        d, more = state.adjoint(f)
        return np.r_[(slope(self.m(z)) * d).ravel(), self.edges.T @ more]

    def solver(self, z: Array, state: State, prior: sp.csr_array) -> Callable[[Array], Array]:
        """Solve the Gauss-Newton system, for a matrix of the prior of m with its damping.

        By conjugate gradients. The preconditioner is the inverse of that matrix and, for the
        edges, of their own block.
        """
        factor = cholesky_banded(_band(prior), lower=True, check_finite=False), True
        own = cho_factor(self._edge_block, lower=True) if self.edges.shape[1] else None

        def hessian(d: Array) -> Array:
            total = self.back(z, state, self.g * self.seen(self.forth(z, state, d)))
            total[: self.elements] += prior @ d[: self.elements]
            total[self.elements :] += d[self.elements :]
            return total

        def rough(r: Array) -> Array:
            m = cho_solve_banded(factor, r[: self.elements], check_finite=False)
            return m if own is None else np.r_[m, cho_solve(own, r[self.elements :])]

        shape = (z.size, z.size)
        A, M = LinearOperator(shape, hessian), LinearOperator(shape, rough)

        def solve(right: Array) -> Array:
            return cg(A, right, M=M, rtol=1e-2, maxiter=60)[0]

        return solve

    @cached_property
    def _edge_block(self) -> Array:
        """Hessian of the edges' motion in a homogeneous sample."""
        count = self.edges.shape[1]
        state, none = self.model.solve(np.zeros(self.model.shape)), np.zeros(self.model.shape)
        columns = (self.edges[:, [k]].toarray().ravel() for k in range(count))
        G = np.stack([self.seen(state.derivative(none, column)).ravel() for column in columns])
        return G @ G.T + np.eye(count)

    def prior(self, m: Array) -> sp.csr_array:
        """Matrix of ``int |grad d|^2 / sqrt(|grad m|^2 + epsilon^2)`` for d on the elements."""
        D1, D2 = self.gradients
        size = np.sqrt((D1 @ m.ravel()) ** 2 + (D2 @ m.ravel()) ** 2 + self.epsilon**2)
        W = sp.diags_array(self.weights * self.area / size)
        R = D1.T @ W @ D1 + D2.T @ W @ D2
        return R + ANCHOR * R.diagonal().mean() * sp.eye_array(m.size)

    @property
    def area(self) -> float:
        """Of an element, px^2."""
        return self.model.sides[0] * self.model.sides[1]

    @cached_property
    def gradients(self) -> tuple[sp.csr_array, sp.csr_array]:
        """Forward differences along x1 and x2, zero at the far ends, 1/px."""
        T2, T1 = (
            sp.diags_array([np.r_[-np.ones(k - 1), 0], np.ones(k - 1)], offsets=[0, 1]) / h
            for k, h in zip(self.model.shape, self.model.sides[::-1], strict=True)
        )
        rows, columns = self.model.shape
        return sp.kron(sp.eye_array(rows), T1, "csr"), sp.kron(T2, sp.eye_array(columns), "csr")


def gauss_newton(
    problem: Inversion, z: Array, gamma: float, settings: Identification, report: Report
) -> Array:
    """Minimiser for one weight, started from ``z``.

    Levenberg's damping falls with every step that improves and grows with every other:
    where E is extreme, the images hardly change with it, and plain steps overshoot.
    """
    state = problem.state(z)
    cost = problem.cost(z, state, gamma)
    damping = settings.damping
    for step in range(settings.iterations):
        trial = z + problem.improve(z, state, gamma, damping)
        trial_state = problem.state(trial)
        gain = cost - problem.cost(trial, trial_state, gamma)
        report(gamma, step + 1, gain)
        if gain <= 0:
            damping *= 8
            continue
        z, state, cost, damping = trial, trial_state, cost - gain, damping / 4
        if gain < settings.least_gain:
            break
    return z


def slope(m: Array) -> Array:
    """Return the derivative of log E by ``m``: 1 where E is moderate, 0 where it is extreme."""
    return 1 - np.tanh(m / LARGEST) ** 2


def _band(A: sp.csr_array) -> Array:
    """Lower band of a symmetric matrix, as LAPACK stores it."""
    lower = sp.tril(A, format="coo")
    row, column = lower.coords
    band = np.zeros(((row - column).max() + 1, A.shape[0]))
    band[row - column, column] = lower.data
    return band
