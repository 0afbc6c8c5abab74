"""The functional of the identification on elements, its minimiser, and the choice of its weight."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse.linalg import LinearOperator, cg

from eofm.elasticity.sensitivity import Elastic, State
from eofm.flow.functional import Pointwise
from eofm.grid import Array
from eofm.settings import Identification

# Contrasts beyond 10 cannot be told apart: the inclusion is rigid, or empty.
LARGEST = np.log(30)
# Part of the prior's mean diagonal that pulls log E to 0: stiffness has no absolute scale
# where all motions are prescribed.
ANCHOR = 1e-6
STEP = 3.0
# Gain below which fits that are only compared stop, in units of ``least_gain``: they rank weights
# long before they have converged.
COMPARED = 10.0

# Called after each Gauss-Newton step with gamma, the number of the step and its gain.
Report = Callable[[float, int, float], object]


@dataclass(frozen=True)
class Problem:
    """The linearised images and the forward model."""

    model: Elastic
    correction: Array
    data: Pointwise
    epsilon: float

    def state(self, m: Array) -> State:
        """Elastic state of ``m``."""
        return self.model.solve(LARGEST * np.tanh(m / LARGEST))

    def u(self, state: State) -> Array:
        """Its displacement; the error of the mesh for E = 1 is taken off, px."""
        return self.model.to_pixels(state.u) + self.correction

    def cost(self, m: Array, state: State, gamma: float) -> float:
        """Value of the functional, bar a constant."""
        u = self.u(state)
        fit = (self.data.product(u) * u - 2 * self.data.b * u).sum()
        size = np.sqrt(sum((D @ m.ravel()) ** 2 for D in self.gradients) + self.epsilon**2)
        return float(fit + 2 * gamma * self.area * size.sum())

    def improve(self, m: Array, state: State, gamma: float, damping: float) -> Array:
        """Damped Gauss-Newton step from ``m``."""
        prior = gamma * self.prior(m)
        right = self.back(m, state, self.misfit(state)) - prior @ m.ravel()
        return self.solver(m, state, prior + damping * sp.eye_array(m.size))(right)

    def misfit(self, state: State) -> Array:
        """Half the negative slope of the data term in u, shape (2, height, width)."""
        return self.data.b - self.data.product(self.u(state))

    def back(self, m: Array, state: State, f: Array) -> Array:
        """Adjoint of the derivative of u by ``m``, flattened."""
        return (slope(m) * state.adjoint(f)).ravel()

    def solver(self, m: Array, state: State, prior: sp.csr_array) -> Callable[[Array], Array]:
        """Solve the Gauss-Newton system, for a matrix of the prior with its damping.

        By conjugate gradients, with the inverse of that matrix as preconditioner.
        """
        factor = cholesky_banded(_band(prior), lower=True, check_finite=False), True
        shape = (m.size, m.size)

        def hessian(d: Array) -> Array:
            du = state.derivative(slope(m) * d.reshape(m.shape))
            return self.back(m, state, self.data.product(du)) + prior @ d

        A = LinearOperator(shape, hessian)
        M = LinearOperator(shape, lambda r: cho_solve_banded(factor, r, check_finite=False))

        def solve(right: Array) -> Array:
            return cg(A, right, M=M, rtol=1e-2, maxiter=60)[0].reshape(m.shape)

        return solve

    def prior(self, m: Array) -> sp.csr_array:
        """Matrix of ``int |grad d|^2 / sqrt(|grad m|^2 + epsilon^2)`` for d on the elements."""
        D1, D2 = self.gradients
        size = np.sqrt((D1 @ m.ravel()) ** 2 + (D2 @ m.ravel()) ** 2 + self.epsilon**2)
        W = sp.diags_array(self.area / size)
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
    problem: Problem, m: Array, gamma: float, settings: Identification, report: Report
) -> Array:
    """Minimiser for one weight, started from ``m``.

    Levenberg's damping falls with every step that improves and grows with every other:
    where E is extreme, the images hardly change with it, and plain steps overshoot.
    """
    state = problem.state(m)
    cost = problem.cost(m, state, gamma)
    damping = settings.damping
    for step in range(settings.iterations):
        trial = m + problem.improve(m, state, gamma, damping)
        trial_state = problem.state(trial)
        gain = cost - problem.cost(trial, trial_state, gamma)
        report(gamma, step + 1, gain)
        if gain <= 0:
            damping *= 8
            continue
        m, state, cost, damping = trial, trial_state, cost - gain, damping / 4
        if gain < settings.least_gain:
            break
    return m


def choose_gamma(
    problem: Callable[[NDArray[np.bool_]], Problem],
    losses: Callable[[Array, NDArray[np.bool_]], Array],
    folds: Sequence[NDArray[np.bool_]],
    settings: Identification,
    report: Report,
) -> float:
    """Largest weight whose successor is not clearly better.

    A third of the weight counts as better where the mean misfit of held-out blocks falls by
    more than ``clear`` standard errors of the difference (as in the rule of one standard
    error, Breiman et al., Classification and Regression Trees, 1984, but between paired
    blocks); otherwise the stronger prior is kept. Fits for this stop at ten times the least gain.

    Parameters
    ----------
    problem : callable
        ``problem(mask)`` is the one that sees the pixels of a mask.
    losses : callable
        ``losses(u, mask)`` holds the misfit of each block of a mask.
    folds : sequence of masks
        The pixels held out in turn.
    """
    low, gamma = settings.gamma_range
    rough = settings.changed(least_gain=COMPARED * settings.least_gain)
    parts = [problem(~out) for out in folds]
    m = [np.zeros(part.model.shape) for part in parts]

    def fit(gamma: float) -> Array:
        for k, part in enumerate(parts):
            m[k] = gauss_newton(part, m[k], gamma, rough, report)
        fields = (part.u(part.state(m_k)) for part, m_k in zip(parts, m, strict=True))
        return np.concatenate([losses(u, out) for u, out in zip(fields, folds, strict=True)])

    loss = fit(gamma)
    while gamma / STEP >= low:
        trial = fit(gamma / STEP)
        gains = loss - trial
        if gains.mean() <= settings.clear * gains.std() / np.sqrt(gains.size):
            break
        gamma, loss = gamma / STEP, trial
    return gamma


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
