"""How far an estimate may be off: draws of its error.

The estimate v minimises F, so its error is ``K^-1 (sum g n - alpha R u)`` for the noise n of the
data: what they add, and what smoothness takes away. Neither is known; both are drawn.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eofm.flow.functional import Pointwise, Quadratic
from eofm.flow.hierarchy import Levels, hierarchy
from eofm.flow.matching import Match
from eofm.flow.multigrid import multigrid
from eofm.grid import Array, precision
from eofm.imaging.intensity import Window
from eofm.imaging.sampling import weights
from eofm.imaging.sums import Terms, resample

# Distance of the random coefficients of multipliers, samples: residuals times gradients are
# correlated less far, be they noise, decorrelated speckle or bubbles that do not follow.
APART = 4.0
# Widths over which brightness that was not fitted is smooth, and over which residuals are compared
# with what may have been fitted of them, samples.
BRIGHTNESS, CONSTANT = 8.0, 16.0
# Errors from white noise as they are drawn, as a part of what they are: residuals that are
# completed by an independent error lack what both would share.
SHOWN = 0.82
# Draws before those that count, until residuals are complete.
SETTLE = 3
# Relative residual of a solve, which leaves less than a hundredth of a draw.
TOLERANCE = 5e-2
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

    def draws(self, rng: np.random.Generator) -> Iterator[Array]:
        """Errors as they may be, in true lengths, of the shape of ``match.u``: as many as asked.

        The noise of the data is the residual, times a smooth random field (dependent wild
        bootstrap, Shao, J. Am. Stat. Assoc. 105, 2010): residuals are correlated and grow with
        the gradient, so white noise would promise too much. The field has followed a part of the
        noise, so the residual is taken where the truth may be, off by the error drawn before
        (data augmentation, Tanner and Wong, J. Am. Stat. Assoc. 82, 1987). What smoothness takes
        away is the bias, of random sign, and a rough field, for the estimate shows what is left
        of roughness only; it alone is large where no data are.
        """
        levels = hierarchy(self.functional)
        error = self._first(levels)
        roughness = self._roughness(levels, error)
        while True:
            b = self._noise(error, rng)
            b += roughness * self._rough(rng)
            b += np.sqrt(0.5) * rng.standard_normal() * self._force
            error = self._solve(levels, b)
            yield error

    def _first(self, levels: Levels) -> Array:
        """An error from the noise alone."""
        rng, error = np.random.default_rng(0), np.zeros_like(self.match.g)
        for _ in range(SETTLE):
            error = self._solve(levels, self._noise(error, rng))
        return error

    def _roughness(self, levels: Levels, first: Array) -> float:
        """Factor of draws of the prior, which have the other half of the energy of the bias.

        The bias as the estimate shows it is that of the noise in it as well, which is taken off.
        """
        F = self.functional

        def energy(b: Array) -> float:
            f = self._solve(levels, b)
            return float((F.terms.product(f) * f * F.grid.areas).sum())

        biased, noisy = energy(self._force), energy(F.smoothed(first))
        rough = energy(self._rough(np.random.default_rng(1)))
        return float(np.sqrt(0.5 * max(biased - noisy, 0.0) / (rough + TINY)))

    def _noise(self, error: Array, rng: np.random.Generator) -> Array:
        """Force of the noise, if the estimate is off by an error.

        Brightness that was not fitted is smooth, and hardly moves anything, as a whole; a random
        field would make edges of it.
        """
        match, smooth = self.match, self._brightness
        fitted = np.einsum("c...,c...->...", match.g, error)
        # Where data determine a field and no more, an error would grow from draw to draw.
        around = Window(match.used, CONSTANT)
        most = around.mean(match.r, match.r) / (around.mean(fitted, fitted) + TINY)
        fitted *= np.sqrt(np.clip(most, 0, 1))
        noise = smooth_noise(match.grid.shape, rng)
        noise *= match.r - smooth + fitted
        noise += rng.standard_normal() * smooth
        noise *= match.used
        noise /= SHOWN
        return match.g * noise

    @cached_property
    def _brightness(self) -> Array:
        return Window(self.match.used, BRIGHTNESS).mean(self.match.r)

    def _rough(self, rng: np.random.Generator) -> Array:
        """Draw of the prior, whose precision is alpha over ``ease``, as F has it multiplied."""
        rough = self.functional.rough(rng)
        rough /= self.functional.grid.areas
        return rough if self.ease is None else rough * np.sqrt(self.ease)

    @cached_property
    def _force(self) -> Array:
        return self.functional.smoothed(self.v)

    def _solve(self, levels: Levels, b: Array) -> Array:
        F = replace(self.functional, terms=Pointwise(self.functional.terms.A, b))
        return multigrid(F, tol=TOLERANCE, levels=levels)


def smooth_noise(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Normal field of variance 1 whose values are alike within a few samples.

    A cubic spline with random coefficients, `APART`.
    """
    terms, count = [], []
    for n in shape:
        at, t = np.divmod(np.arange(n) / APART, 1)
        w = np.stack(weights(t)[0], axis=1)
        w /= np.sqrt((w**2).sum(axis=1, keepdims=True))
        terms.append(Terms(at.astype(np.intp)[:, None] + np.arange(4), w))
        count.append(int(at[-1]) + 4)
    noise = np.empty(shape, precision(len(shape)))
    resample(noise, rng.standard_normal(count).astype(noise.dtype, copy=False), terms)
    return noise
