"""Error bars of an identified sample.

As in `eofm.flow.estimate.Estimate.deviation`, with the Gauss-Newton Hessian H and the prior R
of the modulus: the deviation of a sample of the posterior is
``H^-1 (J^T f + R^(1/2) z)`` with normal z, and for f the residuals, with one random sign
for each block of pixels.
"""

import numpy as np
import scipy.sparse as sp

from eofm.flow.matching import random_signs
from eofm.grid import Array, componentwise
from eofm.identification.inversion import LARGEST, slope
from eofm.identification.stiffness import Stiffness
from eofm.imaging.gaussian import blur
from eofm.threads import serial

# Keeps the preconditioner regular; small against the prior.
DAMPING = 1e-2
# Weight at which a contrast that was not significant might be.
LARGEST_GAMMA = 30.0
# Deviations, from as many parts as there are folds, that hold 68 % of Student's distribution.
STUDENT = 1.2
# Width of the average of the folds' variances, px: four of them tell little of one place.
WIDTH = 3.0


@serial
def deviations(found: Stiffness, *, samples: int = 32, seed: int = 0) -> tuple[Array, Array]:
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
        NaN where E is refused; the displacement's are the estimate's then.
    """
    if found.refused:
        return found.estimate.deviation(samples, seed), np.full_like(found.E, np.nan)
    problem, z, rng = found.problem, found.z, np.random.default_rng(seed)
    state, m = problem.state(z), problem.m(z)
    misfit = problem.misfit(state)
    gamma = min(found.gamma, LARGEST_GAMMA)
    D1, D2 = problem.gradients
    size = np.sqrt((D1 @ m.ravel()) ** 2 + (D2 @ m.ravel()) ** 2 + problem.epsilon**2)
    root = np.sqrt(gamma * problem.weights * problem.area / size)
    prior = gamma * problem.prior(m) + DAMPING * sp.eye_array(m.size)
    solve = problem.solver(z, state, prior)
    squares_u, squares_E = np.zeros_like(misfit), np.zeros(misfit.shape[1:])
    for _ in range(samples):
        right = problem.back(z, state, random_signs(misfit.shape[1:], rng) * misfit)
        z1, z2 = rng.standard_normal((2, m.size))
        right[: m.size] += D1.T @ (root * z1) + D2.T @ (root * z2)
        right[m.size :] += rng.standard_normal(z.size - m.size)
        d = solve(right)
        squares_u = squares_u + problem.forth(z, state, d) ** 2
        d_E = slope(m) * problem.m(d)
        squares_E = squares_E + problem.model.elements_to_pixels(d_E - np.median(d_E)) ** 2
    squares_u /= componentwise(problem.model.spacing, 2) ** 2
    deviation_E = np.hypot(np.sqrt(squares_E / samples), _of_folds(found))
    return np.sqrt(squares_u / samples), deviation_E


def _of_folds(found: Stiffness) -> Array:
    """Jackknife deviation of log E, shape (height, width), from parts of the bubbles left out.

    It knows what the linearised posterior does not: how far the fit follows single bubbles.
    """
    problem, count = found.problem, len(found.choice.z)
    log_E = np.stack([LARGEST * np.tanh(problem.m(z) / LARGEST) for z in found.choice.z])
    log_E -= np.median(log_E, axis=(1, 2), keepdims=True)
    to_pixels = problem.model.elements_to_pixels
    squares = np.sum([to_pixels(change) ** 2 for change in log_E - log_E.mean(0)], axis=0)
    return STUDENT * np.sqrt((count - 1) / count * blur(squares, WIDTH))
