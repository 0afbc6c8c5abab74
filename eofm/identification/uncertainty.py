"""Error bars of an identified sample.

As in `eofm.flow.found.Estimate.deviation`, with the Gauss-Newton Hessian H and the prior R
of the modulus: the deviation of a sample of the posterior is
``H^-1 (J^T f + R^(1/2) z)`` with normal z, and for f the residuals, with one random sign
for each block of pixels.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np
import scipy.sparse as sp
from scipy.linalg import cho_factor, cho_solve

from eofm.elasticity.sensitivity import State
from eofm.flow.matching import random_signs
from eofm.grid import Array, componentwise
from eofm.identification.choice import Choice, Fit
from eofm.identification.inclusions import Outlined
from eofm.identification.inversion import slope
from eofm.imaging.gaussian import blur
from eofm.threads import serial

if TYPE_CHECKING:
    from eofm.identification.stiffness import Stiffness

# Keeps the preconditioner regular; small against the prior.
DAMPING = 1e-2
# Weight at which a contrast that was not significant might be.
LARGEST_GAMMA = 30.0
# Deviations, from as many parts as there are folds, that hold 68 % of Student's distribution.
STUDENT = 1.2
# Least deviation of log E: a modulus is taken to be constant in elements, and in inclusions.
LEAST = 0.01
# Width of the average of the folds' variances of log E, px: four of them tell little of one place.
WIDTH = 3.0


@dataclass(frozen=True)
class Errors:
    """Of what an inversion finds, and of the modulus.

    Attributes
    ----------
    fit : Fit
    choice : Choice
        How its prior was chosen.
    """

    fit: Fit
    choice: Choice

    def deviations(self, samples: int, seed: int) -> tuple[Array, Array]:
        """Return the standard deviations of the displacement and of log E at the pixels.

        Each is the largest of two or three, none of which knows all: of the posterior, of parts
        of the bubbles left out, and, for log E, of priors that held-out bubbles do not rule out.
        They share the noise of the data, so that their sum would count it twice.
        """
        fits, sides = self.choice.fits, componentwise(self.fit.problem.model.spacing, 2)
        u, log_E = self._posterior(samples, seed)
        folds_u = np.sqrt(jackknife([fit.u / sides for fit in fits]))
        folds_E = np.sqrt(blur(jackknife([fit.log_E for fit in fits]), WIDTH))
        log_E = np.maximum.reduce([log_E, folds_E, self._priors, np.full_like(log_E, LEAST)])
        return np.maximum(u, folds_u), log_E

    def _posterior(self, samples: int, seed: int) -> tuple[Array, Array]:
        problem, z, rng = self.fit.problem, self.fit.z, np.random.default_rng(seed)
        state, m = problem.state(z), problem.m(z)
        misfit = problem.misfit(state)
        squares_u, squares_E = np.zeros_like(misfit), np.zeros(misfit.shape[1:])
        draw = self._outlines if self.fit.outlined else self._elements
        for d in draw(state, misfit, rng, samples):
            squares_u = squares_u + problem.forth(z, state, d) ** 2
            d_E = slope(m) * problem.m(d)
            squares_E = squares_E + problem.model.elements_to_pixels(d_E - np.median(d_E)) ** 2
        squares_u /= componentwise(problem.model.spacing, 2) ** 2
        return np.sqrt(squares_u / samples), np.sqrt(squares_E / samples)

    def _elements(
        self, state: State, misfit: Array, rng: np.random.Generator, samples: int
    ) -> Iterator[Array]:
        """Errors of ``z`` as they may be, of a modulus that varies from element to element."""
        problem, z = self.fit.problem, self.fit.z
        m = problem.m(z)
        gamma = min(self.choice.prior.weight, LARGEST_GAMMA)
        D1, D2 = problem.gradients
        size = np.sqrt((D1 @ m.ravel()) ** 2 + (D2 @ m.ravel()) ** 2 + problem.epsilon**2)
        root = np.sqrt(gamma * problem.weights * problem.area / size)
        prior = gamma * problem.prior(m) + DAMPING * sp.eye_array(m.size)
        solve = problem.solver(z, state, prior)
        for _ in range(samples):
            right = problem.back(z, state, random_signs(misfit.shape[1:], rng) * misfit)
            z1, z2 = rng.standard_normal((2, m.size))
            right[: m.size] += D1.T @ (root * z1) + D2.T @ (root * z2)
            right[m.size :] += rng.standard_normal(z.size - m.size)
            yield solve(right)

    def _outlines(
        self, state: State, misfit: Array, rng: np.random.Generator, samples: int
    ) -> Iterator[Array]:
        """The same of inclusions with smooth outlines."""
        found = cast(Outlined, self.fit.outlined)
        G, left = found.derivative(state), found.problem.left(state)
        H = G @ G.T + np.diag(found.prior)
        factor = cho_factor(H + 1e-9 * np.diag(H).max() * np.eye(len(H)))
        changes = found.changes
        for _ in range(samples):
            right = G @ (random_signs(left.shape, rng) * left).ravel()
            right += np.sqrt(found.prior) * rng.standard_normal(len(H))
            yield cho_solve(factor, right) @ changes

    @cached_property
    def _priors(self) -> Array:
        """How far fits with other priors are off: a prior takes contrast off what it smooths."""
        found = self.fit.log_E
        squares = np.zeros_like(found)
        for fits in self.choice.rivals:
            squares += (np.mean([fit.log_E for fit in fits], axis=0) - found) ** 2
        return np.sqrt(squares / max(len(self.choice.rivals), 1))


def jackknife(found: Sequence[Array]) -> Array:
    """Variance of what fits give, each of which a part of the bubbles was left out of.

    It knows what the linearised posterior does not: how far a fit follows single bubbles.
    """
    count = len(found)
    return STUDENT**2 * (count - 1) * np.var(found, axis=0)


@serial
def deviations(found: "Stiffness", *, samples: int = 32, seed: int = 0) -> tuple[Array, Array]:
    """Return the standard deviations of the displacement and of log E.

    Parameters
    ----------
    found : Stiffness
    samples : int
        Number of samples; the relative error of the result is about ``1/sqrt(2 samples)``.
    seed : int

    Returns
    -------
    u : ndarray, shape (2, height, width)
        In px.
    log_E : ndarray, shape (height, width)
        NaN where E is refused.
    """
    if found.alone:
        return found.estimate.deviation(samples, seed), np.full_like(found.E, np.nan)
    u, log_E = found.errors.deviations(samples, seed)
    return u, np.where(np.isnan(found.E), np.nan, log_E)
