"""How far an estimate may be off: draws of its error.

The estimate v minimises F, so its error is ``K^-1 (sum g n - alpha R u)`` for the noise n of the
data: what they add, and what smoothness takes away. Neither is known; both are drawn.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eofm.flow.functional import Pointwise, Quadratic
from eofm.flow.matching import BLOCK, Match
from eofm.flow.multigrid import multigrid
from eofm.grid import Array, precision
from eofm.imaging.intensity import Window
from eofm.imaging.sampling import weights
from eofm.imaging.sums import Terms, resample

# Width of the Gaussian whose average of white noise is correlated as far as `smooth_noise`, and of
# that over which the share of the data that is fitted is taken to be constant, samples.
WIDTH, CONSTANT = 0.58 * BLOCK, 16.0
# Least part of the data at a place that a field leaves to tell its error.
LEAST = 0.1
# Relative residual of a solve: a draw is uncertain by more.
TOLERANCE = 1e-2
TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class Errors:
    """What is drawn from.

    Attributes
    ----------
    functional : Quadratic
        The F that was minimised last.
    match : Match
        The images linearised about the estimate, eased as in F.
    v : ndarray, of the shape of ``match.u``
        The part of the displacement that R acts on.
    ease : ndarray, of the shape of an image, optional
        By which alpha is divided at each pixel, see :func:`eofm.flow.roughness.ease`.
    """

    functional: Quadratic
    match: Match
    v: Array
    ease: Array | None = None

    @cached_property
    def left(self) -> Array:
        """Part of white noise in the data around each pixel that the field does not follow.

        One less the leverage: residuals are smaller than the noise by its root (MacKinnon and
        White, J. Econometrics 29, 1985), little where many data carry the field, and much at
        the edges and for few bubbles. One solve, for noise that is drawn, tells it.
        """
        match = self.match
        noise = np.random.default_rng(0).standard_normal(match.r.shape) * match.used
        noise = noise.astype(match.r.dtype, copy=False)
        v = self._solve(match.g * noise)
        seen, wide = (Window(match.used, width) for width in (WIDTH, CONSTANT))
        before, after = np.zeros_like(noise), np.zeros_like(noise)
        fitted = noise - np.einsum("c...,c...->...", match.g, v)
        for g in match.g:
            all_of_it = seen.mean(g, noise)
            before += all_of_it**2
            after += all_of_it * seen.mean(g, fitted)
        return np.clip(wide.mean(after) / (wide.mean(before) + TINY), LEAST, 1)

    @cached_property
    def bias(self) -> Array:
        """What smoothness takes away, as it takes it from the estimate itself."""
        return self._solve(self._force)

    @cached_property
    def roughness(self) -> float:
        """Factor of draws of the prior that makes them as large as the bias, where data tell."""
        F = self.functional
        drawn = self._solve(self._rough(np.random.default_rng(1)))
        biased, rough = (
            float((F.terms.product(f) * f * F.grid.areas).sum()) for f in (self.bias, drawn)
        )
        return float(np.sqrt(biased / (rough + TINY)))

    def draw(self, rng: np.random.Generator) -> Array:
        """An error as it may be, in true lengths, of the shape of ``match.u``.

        The noise of the data is that of the residuals, times a smooth random field (dependent wild
        bootstrap, Shao, J. Am. Stat. Assoc. 105, 2010): residuals of bubbles are correlated and
        grow with the gradient, so white noise would promise too much. What smoothness takes away
        is the bias, of random sign, and a rough field as large, for the estimate shows what is
        left of roughness only; it alone is large where no data are.
        """
        match = self.match
        noise = smooth_noise(match.grid.shape, rng) * self._residual
        b = match.g * noise + self.roughness * self._rough(rng)
        b += rng.standard_normal() * self._force
        return self._solve(b)

    @cached_property
    def _residual(self) -> Array:
        return self.match.r * self.match.used / np.sqrt(self.left)

    def _rough(self, rng: np.random.Generator) -> Array:
        """Draw of the prior, whose precision is alpha over ``ease``, as F has it multiplied."""
        rough = self.functional.rough(rng) / self.functional.grid.areas
        return rough if self.ease is None else rough * np.sqrt(self.ease)

    @cached_property
    def _force(self) -> Array:
        return self.functional.smoothed(self.v)

    def _solve(self, b: Array) -> Array:
        F = self.functional
        return multigrid(replace(F, terms=Pointwise(F.terms.A, b)), tol=TOLERANCE)


def smooth_noise(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Normal field of variance 1 whose values are alike within the size of a block.

    A cubic spline with random coefficients, one for each block.
    """
    terms, count = [], []
    for n in shape:
        at, t = np.divmod(np.arange(n) / BLOCK, 1)
        w = np.stack(weights(t)[0], axis=1)
        w /= np.sqrt((w**2).sum(axis=1, keepdims=True))
        terms.append(Terms(at.astype(np.intp)[:, None] + np.arange(4), w))
        count.append((n - 1) // BLOCK + 4)
    noise = np.empty(shape, precision(len(shape)))
    resample(noise, rng.standard_normal(count).astype(noise.dtype, copy=False), terms)
    return noise
