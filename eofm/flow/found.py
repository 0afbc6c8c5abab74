"""What an estimate found, and what its images say of it: verdict and error bars."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice

import numpy as np

from eofm.flow.functional import Quadratic
from eofm.flow.likeness import difference
from eofm.flow.matching import Match
from eofm.flow.pair import ImagePair
from eofm.flow.standing import Standing, standing
from eofm.flow.stated import contradictions
from eofm.flow.trial import reach
from eofm.flow.trust import Told, Trust, judge
from eofm.flow.uncertainty import Errors
from eofm.flow.windows import length
from eofm.grid import Array, Edge, Mask, componentwise
from eofm.imaging.flicker import flickers, in_both
from eofm.imaging.gaussian import blur
from eofm.imaging.splines import resize, resize_field

# Width of the average of variances of draws, px.
VARIANCE = 4.0


@dataclass(frozen=True)
class Estimate:
    """An estimate and what it came from.

    Attributes
    ----------
    u : ndarray, shape (2, height, width) or (3, depth, height, width)
        Displacement ``u = u_bg + v``, px, with ``I2(x + u(x)) = I1(x)``: lateral (to the
        right), axial (down) and, of volumes, elevational motion of what was at x before
        compression.
    alpha : float
        Weight of the smoothness term on the last scale, of the preset where motion is rough.
    pair : ImagePair
        The images on the last scale.
    denoising : float, optional
        Filter of the linearised images, see :meth:`eofm.flow.matching.Match.filtered`.
    functional : Quadratic
        The F that was minimised last.
    base : ndarray, shape (ndim, ...)
        The field to which the last scale added what R acts on, in the unit of ``functional``.
    ease : ndarray, shape (height, width), optional
        By which alpha is divided at each pixel, see :func:`eofm.flow.roughness.ease`.
    printed : ndarray of bool, of the images' shape
        Frames and labels, alike in both images, which were left out.
    spacing : tuple of float
        Sides of a pixel in the unit of ``functional``, lateral first.
    stated : mapping of ndarray of bool, shape (ndim, n, ...)
        For each edge, on the last scale, components and pixels whose motion was stated.
    lines : tuple of int
        Axes of the images along which lines of a detector, or lines that flicker, were taken off:
        0 for rows and 1 for columns of an image, 0 for slices of a volume.
    unlike : float
        Share of the pixels that show what the other image does not, and were left out.
    astray : float
        Share of the pixels that show what has moved by pixels otherwise than ``u`` says.
    """

    u: Array
    alpha: float
    pair: ImagePair
    denoising: float | None
    functional: Quadratic
    base: Array
    ease: Array | None
    printed: Mask
    spacing: tuple[float, ...]
    stated: Mapping[Edge, Mask] = field(default_factory=dict)
    lines: tuple[int, ...] = ()
    unlike: float = 0.0
    astray: float = 0.0

    @property
    def weight(self) -> float | Array:
        """Weight of the smoothness term, at each pixel where it is not alike everywhere."""
        if self.ease is None:
            return self.alpha
        return self.alpha / resize(self.ease, self.u.shape[1:])

    @property
    def _sides(self) -> Array:
        return componentwise(self.spacing, len(self.spacing))

    @property
    def lengths(self) -> Array:
        """The displacement in true lengths on the grid of ``pair``."""
        return resize_field(self._sides * self.u, self.pair.grid.shape)

    @cached_property
    def match(self) -> Match:
        """The images linearised about ``u``, in true lengths."""
        return self.pair.linearise_near(self.lengths, self.denoising)

    @cached_property
    def trust(self) -> Trust:
        """Whether the images, on the last scale, bear the estimate out."""
        told = Told(
            self.contradictions,
            self.spread,
            self.standing.pull,
            unlike=self.unlike,
            astray=self.astray,
        )
        return judge(*self.carried_back(), told).on(self.u.shape[1:])

    @property
    def contradictions(self) -> dict[Edge, float]:
        """By how much the images contradict the stated motion of edges, px, where they do."""
        match = self.match.eased(self.ease)
        v = match.u - self.base
        return contradictions(match, self.functional, self.base, v, self.stated, self.spread)

    @cached_property
    def standing(self) -> Standing:
        """Whether something stands still in the images while the sample moves."""
        return standing(*self.carried_back())

    @property
    def flickers(self) -> bool:
        """Whether lines of the images, as they are now, flicker."""
        I1, warped, used, _ = self.carried_back()
        if not used.any():
            return False
        rest, _ = difference(I1[used], warped[used])
        return bool(flickers(in_both(I1[used], rest), rest, used))

    def carried_back(self) -> tuple[Array, Array, Mask, Array]:
        """The images as they are, not even their brightness fitted; where; by what, samples."""
        u = self.lengths
        return self.pair.I1, *self.pair.warped(u), self.pair.grid.samples(u)

    @property
    def spread(self) -> float:
        """About how far the images leave the displacement open, px, without any draw.

        The noise over the gradient, in the mean of the pixels over which the weight smooths: once
        to twice the median length of the error bars.
        """
        match, ndim = self.match, self.pair.grid.ndim
        if self.functional.smoothness != "bending" or not match.strength:
            return 0.0
        return float(
            match.noise / math.sqrt(match.strength) / reach(match, self.alpha) ** (ndim / 2)
        )

    def deviation(self, samples: int = 32, seed: int = 0) -> Array:
        """Return the standard deviation of the displacement at each pixel, px.

        Parameters
        ----------
        samples : int
            Number of samples; the relative error of the result is about
            ``1/sqrt(2 samples)``.
        seed : int

        Returns
        -------
        ndarray, of the shape of ``u``

        Examples
        --------
        >>> import numpy as np
        >>> import eofm
        >>> before, after, _ = eofm.make_phantom(np.full((2, 40, 60), 0.3))
        >>> eofm.estimate_displacement(before, after).deviation(samples=4).shape
        (2, 40, 60)
        """
        squares = np.zeros_like(self.u)
        for sample in self.samples(samples, seed):
            squares += sample**2
        # Few draws tell little of one place.
        return np.sqrt(np.stack([blur(variance, VARIANCE) for variance in squares / samples]))

    def samples(self, count: int, seed: int = 0) -> Iterator[Array]:
        """Errors of the displacement as they may be, of its shape, px.

        See :class:`eofm.flow.uncertainty.Errors`. A speckle term on the finest scale
        (``speckle_scales="all"``) counts as exact.
        """
        # What stands still pulls along the displacement.
        pull, strengths = self.standing.pull, np.random.default_rng([seed, 1]).normal(size=count)
        along = self.u * (pull / np.maximum(length(self.u), pull)) if pull else 0
        draws = islice(self.errors.draws(np.random.default_rng(seed)), count)
        for strength, error in zip(strengths, draws, strict=True):
            yield resize_field(error, self.u.shape[1:]) / self._sides + float(strength) * along

    @cached_property
    def errors(self) -> Errors:
        """What errors are drawn from."""
        match = self.match.eased(self.ease)
        return Errors(self.functional, match, match.u - self.base, self.ease)
