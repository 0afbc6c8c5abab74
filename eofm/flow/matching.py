"""How well a displacement carries one image onto the other, to first order."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from eofm.flow.functional import Pointwise, data_term
from eofm.grid import Array, Grid, Mask, precision
from eofm.imaging.gaussian import blur
from eofm.imaging.intensity import Window

# Side of the blocks of pixels that are held out together, and whose residuals are taken to
# be correlated, px: the size of a bubble and more.
BLOCK = 8
# Width of the filter of white noise, and below which there is none, samples.
WHITE, SHARP = 0.6, 0.2
# Whiteness of noise that is white, but for what a spline between pixels makes of it.
ALL_WHITE = 0.8
# Voxels from a face in which a derivative across it has the noise of the voxel itself.
OUTER = 2
TINY = float(np.finfo(np.float32).tiny)
# Entries of an axis and those after them.
NEIGHBOURS = np.s_[:-1], np.s_[1:]
# Width over which the noise is taken to be constant, samples, and least local variance, as a part
# of the image's.
NOISE, LEAST_VARIANCE = 6.0, 0.2
# Least part of a gradient that both images are taken to share.
LEAST_SHARE = 0.05
# Squared residuals count among a local variance up to so many of it, and are outliers from there.
CLIPPED, OUTLIER = 9.0, 20.0


@dataclass(frozen=True)
class Overall:
    """Numbers of whole images, such as the mean weight, which parts of them take over.

    Attributes
    ----------
    known : mapping of tuple of float
        Those of the whole, by name.
    noted : dict of tuple of float
        The others as they were computed last, from the images that there are.
    """

    known: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    noted: dict[str, tuple[float, ...]] = field(default_factory=dict)

    def __call__(self, name: str, compute: Callable[[], tuple[float, ...]]) -> tuple[float, ...]:
        """Return what is known, or compute and note it."""
        if name in self.known:
            return self.known[name]
        self.noted[name] = compute()
        return self.noted[name]


@dataclass(frozen=True)
class Match:
    """Two images linearised about a displacement: ``I2(x + v) - I1 = r + g . (v - u)``.

    Attributes
    ----------
    grid : Grid
    u : ndarray, shape (2, height, width)
        Where the images are linearised, in the unit of the grid's spacing.
    g : ndarray, shape (2, height, width)
    r : ndarray, shape (height, width)
    used : ndarray of bool, shape (height, width)
        Pixels that carry data: neither dead nor moved out of the image.
    weight : ndarray, shape (height, width), optional
        By the root of which g and r were multiplied, see :meth:`weighed`.
    overall : Overall
    """

    grid: Grid
    u: Array
    g: Array
    r: Array
    used: Mask
    weight: Array | None = None
    overall: Overall = field(default_factory=Overall)

    def weighed(self, contrast: Array) -> "Match":
        """Return the same with g and r in units of the noise, which is not alike everywhere.

        Speckle that decorrelates leaves residuals as large as it is bright: their variance is
        taken for a constant and a multiple of the squared local ``contrast``, shape (height,
        width). Where the field fails, as at the edge of an inclusion, residuals are large as
        well, yet no less is known of the motion; only those that stand out from their
        surroundings are outliers (weights of Geman and McClure's kind). The mean weight is 1.
        """
        if not self.used.any():
            return self
        around, r2 = Window(self.used, NOISE), self.r**2
        local = around.mean(r2)
        for _ in range(2):
            local = around.mean(np.minimum(r2, CLIPPED * local))

        def variances() -> tuple[float, ...]:
            # Both are smooth: some of the pixels tell.
            told = np.flatnonzero(self.used)[:: int(NOISE)]
            values, squares = local.ravel()[told], contrast.ravel()[told] ** 2
            least = float(LEAST_VARIANCE * values.mean() + TINY)
            return least, *_variances(values, squares, least)

        least, constant, slope = self.overall("variances", variances)
        w = 1 / (constant + slope * contrast**2 + least)
        w /= 1 + (r2 / (OUTLIER * (local + least))) ** 2
        (mean,) = self.overall("weight", lambda: (float(w[self.used].mean()),))
        w /= mean
        root = np.sqrt(w)
        return replace(self, g=self.g * root, r=self.r * root, weight=w)

    def eased(self, factor: Array | None) -> "Match":
        """Return the same with the data counting ``factor`` times at each pixel."""
        if factor is None:
            return self
        root = np.sqrt(factor)
        return replace(self, g=self.g * root, r=self.r * root)

    def density(self, about: Array, mask: Mask | None = None) -> Pointwise:
        """Return the data term of ``v``, where the displacement is ``about + v``, on a mask."""
        used = self.used if mask is None else self.used & mask
        return data_term(self.g, self.residual(about), used)

    def residual(self, v: Array) -> Array:
        """What a displacement leaves of the difference of the images, shape (height, width)."""
        r = self.r.copy()
        for g, new, old in zip(self.g, v, self.u, strict=True):
            r += g * (new - old)
        return r

    def filtered(self, width: float | None) -> "Match":
        """Return the same after a Gaussian over the pixels that are used, samples.

        Gradients amplify noise, and where that is white, a width of 0.6 takes a fifth off the
        error. What is left of decorrelated speckle, or of bubbles that the field does not
        carry along, has the colour of the images, and a filter takes away more of the
        signal; without a ``width`` it is 0.6 times the share of white noise. The images
        themselves are not filtered, for at the edges a filter sees what lies beyond them in
        one image and not in the other, which would move them.
        """
        width = WHITE * self._white if width is None else width
        if width < SHARP:
            return self
        g, r = _smooth((self.g, self.r[None]), self.used, width)
        return replace(self, g=g, r=r[0])

    def shared(self, g1: Array, width: float | None) -> "Match":
        """Return the same, filtered, with the gradient that both images are expected to have.

        The product of the noise of a warped image and of its gradient has a mean, for the
        noise that a spline lets through depends on where between the pixels it is taken.
        That would pull motions; as far as noise is white, g is the gradient of I1 alone,
        ``g1``, else the mean ``g``. It is then multiplied by the part of its square that
        gradients of both images have in common around a pixel, as in a regression whose
        regressors are uncertain (Carroll and others, Measurement Error in Nonlinear Models,
        2006, ch. 4): noise is no structure, and would promise a motion that is known better.

        Beyond a face images go on as they are, so the derivative across it has there the noise of
        the voxel itself, and its product with the residual a mean, which would stretch the field.
        Of volumes it is left out as far as noise is white; of images, whose edges are a smaller
        part, that loses as much as it gains.
        """
        white, g, g2 = self._white, g1, 2 * self.g
        g2 -= g1
        r, width = self.r, WHITE * white if width is None else width
        alone = min(1.0, white / ALL_WHITE)
        if r.ndim == 3:
            _damp_across(g, 1 - alone)
            _damp_across(g2, 1 - alone)
        if width >= SHARP:
            g, g2, (r,) = _smooth((g, g2, r[None]), self.used, width)
        around = Window(self.used, NOISE)
        common = around.mean(_dot(g, g2))
        g = 0.5 * ((1 + alone) * g + (1 - alone) * g2)
        own = around.mean(_dot(g, g))
        (mean,) = self.overall("gradient", lambda: (float(own.mean()),))
        common /= own + LEAST_VARIANCE * LEAST_SHARE * mean + TINY
        g *= np.clip(common, LEAST_SHARE, 1, out=common)
        return replace(self, g=g, r=r)

    @property
    def _white(self) -> float:
        """The whiteness of the whole."""
        return self.overall("white", lambda: (self.whiteness,))[0]

    @cached_property
    def whiteness(self) -> float:
        """How white the residual is where there are gradients, from 0 to 1.

        The correlation of neighbours is 0 for white noise, and half for what clean images
        leave, whose bubbles are as wide as the gradients.
        """
        weight = (self.g**2).sum(0) * self.used
        white = []
        for axis in reversed(range(weight.ndim)):
            before, after = (
                tuple(part if k == axis else slice(None) for k in range(weight.ndim))
                for part in NEIGHBOURS
            )
            w = np.sqrt(weight[before] * weight[after])
            r = self.r[before]
            white.append(1 - (w * r * self.r[after]).sum() / max((w * r**2).sum(), TINY))
        return float(np.clip(2 * np.mean(white) - 1, 0, 1))

    @property
    def strength(self) -> float:
        """Mean of the squared gradient, 0 where no pixel carries data."""
        return float((self.g**2 * self.used).mean())

    @property
    def noise(self) -> float:
        """Standard deviation of the residual at ``u``, in units of the normalised images."""
        return float(np.sqrt(np.mean(self.r[self.used] ** 2))) if self.used.any() else 0.0


def _damp_across(g: Array, factor: float) -> None:
    """Multiply derivatives across faces by a factor in the outer voxels, in place."""
    for c, component in enumerate(g):
        across = np.moveaxis(component, len(g) - 1 - c, 0)
        across[:OUTER] *= factor
        across[-OUTER:] *= factor


def _smooth(fields: Sequence[Array], used: Mask, width: float) -> list[Array]:
    """Gaussian averages over the pixels that are used, of stacks of fields."""
    mask = used.astype(fields[0].dtype)
    share = np.maximum(blur(mask, width), 1e-6)
    return [np.stack([blur(f * mask, width) / share for f in stack]) for stack in fields]


def _dot(f: Array, g: Array) -> Array:
    """Product of vectors at each pixel."""
    return np.einsum("c...,c...->...", f, g)


def _variances(variance: Array, squares: Array, least: float) -> tuple[float, float]:
    """Constant and slope, neither negative, of variances over squares of the contrast.

    A variance is uncertain by a part of itself, so the fit is weighed by that of the fit before.
    """
    constant, slope = float(variance.mean()), 0.0
    for _ in range(4):
        w = 1 / (constant + slope * squares + least) ** 2
        w /= w.sum()
        x, y = (w * squares).sum(), (w * variance).sum()
        spread = (w * squares**2).sum() - x**2
        slope = max(0.0, float(((w * squares * variance).sum() - x * y) / max(spread, TINY)))
        constant = float(y - slope * x)
        if constant < 0:
            constant = 0.0
            slope = float((w * squares * variance).sum() / max((w * squares**2).sum(), TINY))
    return constant, slope


def held_out(shape: tuple[int, ...], fold: int = 0, block: int = BLOCK) -> Mask:
    """Mark a quarter of the pixels, in blocks spread evenly; ``fold`` is 0 to 3."""
    number = np.zeros((), np.uint8)  # where 256 is 0, so it is modulo 4
    for n, step in zip(shape, (1, 2, 1)[-len(shape) :], strict=True):
        k = np.arange(n) // block
        number = np.add.outer(number, (step * k + (k // 2 if step == 2 else 0)).astype(np.uint8))
    return number % 4 == fold


def random_signs(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """One random sign for each block of pixels, of a shape."""
    blocks = [np.arange(n) // BLOCK for n in shape]
    signs = rng.choice([-1.0, 1.0], [k[-1] + 1 for k in blocks])
    return signs.astype(precision(len(shape)), copy=False)[np.ix_(*blocks)]
