"""Two images on a grid, linearised about a displacement."""

from dataclasses import dataclass, field

import numpy as np

from eofm.flow.matching import NOISE, Match, Overall
from eofm.grid import Array, Grid, Mask, componentwise
from eofm.imaging.intensity import Window
from eofm.imaging.splines import Spline

# Share of data at a place between pixels that carry data and others.
LIVE = 0.9
# Width over which brightness and contrast are taken to be constant, samples, and least local
# contrast, as a part of the image's: black is not to be raised.
BRIGHTNESS, LEAST_CONTRAST = 12.0, 0.02
TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class ImagePair:
    """Two images on a grid.

    Attributes
    ----------
    grid : Grid
    I1, I2 : ndarray, shape (height, width)
    live, live_after : ndarray of bool, shape (height, width)
        Pixels that carry data, in I1 and in I2.
    mean : bool
        Whether g is the mean of the gradients of I1 and of the warped I2, which is exact to
        second order and halves the variance of their noise, or the gradient of I1, as in
        the paper.
    robust : bool
        Whether I1 is given the local brightness and contrast of the warped I2, and residuals
        are weighed.
    straight : bool
        Whether images go on beyond their edges as they are, see :class:`Spline`, where a mirror
        would level them: that alone is half of the error at the edges of clean images.
    offset : tuple of int, optional
        Where the grid begins in I2, samples, lateral first, if that shows more than the grid.
    overall : Overall
        Of the whole images, if these are parts.
    even : bool
        Whether the brightness and contrast that I1 is given are those of the whole image.
    """

    grid: Grid
    I1: Array
    I2: Array
    live: Mask
    live_after: Mask
    mean: bool
    robust: bool = False
    straight: bool = False
    offset: tuple[int, ...] = ()
    overall: Overall = field(default_factory=Overall)
    even: bool = False

    def linearise(self, u: Array) -> Match:
        """Return the images linearised about a displacement."""
        return self._linearise(u)[0]

    def linearise_near(self, u: Array, denoising: float | None) -> Match:
        """Return the same about a field whose residual is noise: filtered and weighed."""
        match, g1, contrast = self._linearise(u)
        if not self.robust:
            return match.filtered(denoising)
        shared = match.shared(g1, denoising) if self.mean else match.filtered(denoising)
        return shared.weighed(contrast)

    def warped(self, u: Array) -> tuple[Array, Mask]:
        """The image after compression, carried back by a displacement, and where that has data."""
        samples = self._samples(u)
        warped, inside = Spline(self.I2, self.straight).warp(samples)
        return warped, self._used(samples, inside)

    def _samples(self, u: Array) -> Array:
        """A displacement in samples of I2, from where it begins."""
        samples = self.grid.samples(u)
        return samples + componentwise(self.offset, len(u)) if any(self.offset) else samples

    def _used(self, samples: Array, inside: Mask) -> Mask:
        used = inside & self.live
        if not self.live_after.all():
            used &= Spline(self.live_after.astype(samples.dtype)).warp(samples)[0] > LIVE
        return used

    def shading(self, u: Array) -> float:
        """How much brightness changes after a displacement, but for one gain and one offset.

        Root mean square, as a part of the local contrast.
        """
        warped, used = Spline(self.I2, self.straight).warp(self.grid.samples(u))
        used &= self.live
        if not used.any():
            return 0.0
        gain, offset, contrast = brightness(self.I1, warped, used, self.overall)
        I, J, c = (f[used][:: int(NOISE)] for f in (self.I1, gain * self.I1 + offset, contrast))
        rest = J - np.polyval(np.polyfit(I, J, 1), I)
        return float(np.sqrt((rest**2).mean() / (c**2).mean()))

    def _linearise(self, u: Array) -> tuple[Match, Array, Array]:
        """Images linearised about a displacement, the gradient of I1, and local contrast."""
        samples, after = self._samples(u), Spline(self.I2, self.straight)
        if self.mean:
            warped, g, inside = after.warp_with_gradient(samples, self.grid.spacing)
        else:
            warped, inside = after.warp(samples)
        del after
        used = self._used(samples, inside)
        g1 = Spline(self.I1, self.straight).gradient(self.grid.spacing)
        I1, contrast = self.I1, np.ones((), u.dtype)
        if self.robust and used.any():
            gain, offset, contrast = brightness(I1, warped, used, self.overall)
            if self.even:
                a, b = I1[used], warped[used]
                gain[:] = b.std() / (a.std() + TINY)
                offset[:] = b.mean() - gain * a.mean()
            g1 *= gain
            I1 = np.add(np.multiply(gain, I1, out=gain), offset, out=gain)
        if self.mean:
            g += g1
            g /= 2
        else:
            g = g1
        warped -= I1
        return Match(self.grid, u, g, warped, used, overall=self.overall), g1, contrast


def brightness(
    I1: Array, warped: Array, used: Mask, overall: Overall
) -> tuple[Array, Array, Array]:
    """Gain and offset that give I1 the local mean and contrast of the warped I2; that contrast.

    A generalised dynamic image model (Negahdaripour, IEEE Trans. Pattern Anal. Mach. Intell. 20,
    1998) by moments, which noise in both images does not bias as a regression would be. An average
    at an edge is that of what lies inside, which a ramp makes wrong, so ramps are taken off first;
    and the contrast is that about the local mean, not about one mean of a whole window.
    """
    around = Window(used, BRIGHTNESS)
    spreads = overall("spreads", lambda: tuple(float(np.std(I, where=used)) for I in (I1, warped)))

    def moments(I: Array, spread: float) -> tuple[Array, Array]:
        ramp = around.trend(I)
        rest = I - ramp
        mean = around.mean(rest)
        rest -= mean
        mean += ramp
        contrast = around.mean(rest, rest)
        contrast += (LEAST_CONTRAST * spread) ** 2 + TINY
        return mean, np.sqrt(contrast, out=contrast)

    (mean1, gain), (mean2, contrast) = map(moments, (I1, warped), spreads)
    np.divide(contrast, gain, out=gain)
    mean1 *= gain
    return gain, np.subtract(mean2, mean1, out=mean2), contrast
