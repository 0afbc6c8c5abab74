"""The accurate estimate: bending energy, several warps, a strength set by the images.

It keeps the paper's functional, eq. (def_F), with ``R(v) = int sum_jk |d_jk v|^2``. The weight
of R is chosen by cross-validation: blocks of pixels are held out, and the field that the
other pixels give has to carry the second image onto the first in those blocks. That
needs neither the noise level nor the truth, and works for few bubbles on black, where
most residuals come from the model, as for dense speckle, where they are noise.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eofm.bubbles import as_arrays
from eofm.config import Preset
from eofm.errors import InputError
from eofm.functional import Grid, Pointwise, data_term, speckle_term
from eofm.images import evaluate_field, gradient, normalise, resize_field, warp, warp_field
from eofm.multiscale import coarse_to_fine, pyramid
from eofm.splines import Minimum, Splines

Array = NDArray[np.float64]

# Ratio of two weights that are compared: the minimum is flat.
STEP = 3.0
# Fewer blocks than these on the second finest scale do not tell weights apart.
BLOCKS = 50


@dataclass(frozen=True)
class Estimate:
    """An estimate and how it came about.

    Attributes
    ----------
    u : ndarray, shape (2, height, width)
        Displacement, px.
    alpha : float
        Weight of the bending energy.
    noise : float
        Standard deviation of ``I2(x + u) - I1``, in the units of the normalised images.
    minimum : Minimum
        The last linearised problem, for the posterior's samples.
    """

    u: Array
    alpha: float
    noise: float
    minimum: Minimum

    def deviation(self, samples: int = 32, seed: int = 0) -> Array:
        """Return the standard deviation of the displacement at each pixel, px.

        Shape (2, height, width): that of the posterior of the linearised problem, sampled.
        It is for free estimates; an identified background has errors of its own, see
        `eofm.uncertainty`.
        """
        rng = np.random.default_rng(seed)
        draws = [self.minimum.sample(rng) for _ in range(samples)]
        return self.noise * np.sqrt(np.mean(np.square(draws), axis=0))


@dataclass(frozen=True)
class ImagePair:
    """Two images on a grid, their gradients, and the background there."""

    grid: Grid
    I1: Array
    I2: Array
    background: Array

    def linearise(self, u: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """``g``, ``r`` and where they hold: ``I2(x + u + d) - I1 = r + g . d`` to first order.

        ``g`` is the mean of the gradients of I1 and of the warped I2, which is exact to
        second order in d and halves the variance of their noise.
        """
        samples = u / np.reshape(self.grid.spacing, (2, 1, 1))
        warped, inside = warp(self.I2, samples)
        grad_I1, grad_I2 = self._gradients
        g = (grad_I1 + warp_field(grad_I2, samples)) / 2
        return g, warped - self.I1, inside

    def density(self, u: Array, mask: NDArray[np.bool_] | bool = True) -> Pointwise:
        """Return the data term of ``u_bg + v``, linearised about ``u``, on a mask."""
        g, r, inside = self.linearise(u)
        return data_term(g, r - (g * (u - self.background)).sum(0), inside & mask)

    def misfit(self, u: Array, mask: NDArray[np.bool_] | bool = True) -> float:
        """Mean of ``|I2(x + u) - I1|^2`` over a mask, where inside of I2."""
        warped, inside = warp(self.I2, u / np.reshape(self.grid.spacing, (2, 1, 1)))
        used = inside & mask
        return float(np.mean((warped - self.I1)[used] ** 2)) if used.any() else np.inf

    def block_misfits(self, u: Array, block: int) -> Array:
        """Mean of ``|I2(x + u) - I1|^2`` of the held-out blocks, one value per block."""
        warped, inside = warp(self.I2, u / np.reshape(self.grid.spacing, (2, 1, 1)))
        used = held_out(self.grid.shape, block) & inside
        rows, columns = (np.arange(n) // block for n in self.grid.shape)
        label = (rows[:, None] * (columns[-1] + 1) + columns)[used]
        count = np.bincount(label)
        total = np.bincount(label, (warped - self.I1)[used] ** 2)
        return total[count > 0] / count[count > 0]

    @cached_property
    def _gradients(self) -> tuple[Array, Array]:
        return gradient(self.I1, self.grid.spacing), gradient(self.I2, self.grid.spacing)


def held_out(shape: tuple[int, ...], block: int, fold: int = 0) -> NDArray[np.bool_]:
    """Mark a quarter of the pixels, in blocks spread evenly; ``fold`` is 0 to 3."""
    rows, columns = (np.arange(n) // block for n in shape)
    return (2 * rows[:, None] + columns + (rows[:, None] // 2)) % 4 == fold


def choose_alpha(pair: ImagePair, space: Splines, u: Array, settings: Preset = Preset()) -> float:
    """Weight with the least misfit on held-out blocks, linearised about ``u``.

    Goes downhill from ``alpha_start`` in factors of 3, then to the vertex of the parabola
    through the three best in log alpha: four or five solves.
    """
    folds = [held_out(pair.grid.shape, settings.block, k) for k in (0, 2)]
    terms = [pair.density(u, ~out) for out in folds]
    misfits: dict[int, float] = {}

    def misfit(k: int) -> float:
        if k not in misfits:
            alpha = settings.alpha_start * STEP**k
            low, high = settings.alpha_range
            fields = (pair.background + space.minimise(t, alpha).v for t in terms)
            misfits[k] = (
                sum(pair.misfit(f, out) for f, out in zip(fields, folds, strict=True))
                if low <= alpha <= high
                else np.inf
            )
        return misfits[k]

    k = 0
    while (better := min((k - 1, k + 1), key=misfit)) and misfit(better) < misfit(k):
        k = better
    left, middle, right = (misfit(j) for j in (k - 1, k, k + 1))
    curvature = left - 2 * middle + right
    shift = 0.5 * (left - right) / curvature if 0 < curvature < np.inf else 0.0
    return float(settings.alpha_start * STEP ** (k + shift))


def estimate_preset(
    I1: Array,
    I2: Array,
    settings: Preset = Preset(),
    *,
    bubbles: pd.DataFrame | None = None,
    background: Array | None = None,
    progress: bool = False,
) -> Estimate:
    """Displacement between two images, as accurately as this package can.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width)
        Images before and after compression.
    settings : Preset
    bubbles : DataFrame, optional
        Columns x1, x2, u1, u2, px; they lead the coarse scales past motions that are
        larger than the speckle.
    background : ndarray, shape (2, height, width), optional
        The field u_bg of eq. (Ansatz), px.
    progress : bool
        Show a progress bar, if standard error is a terminal.

    Returns
    -------
    Estimate
        Its ``u`` satisfies ``I2(x + u(x)) = I1(x)``.

    Raises
    ------
    InputError
        If the images are constant, differ in size from each other or from the
        background, or are too small.

    Notes
    -----
    The weight is the larger one of those chosen on the two finest scales. Residuals that
    are correlated, as those of decorrelated speckle are, make cross-validation choose too
    little smoothing (Opsomer, Wang and Yang, Stat. Sci. 16, 2001), and to err on the side
    of smoothness costs less than the other.
    """
    u_bg = np.zeros((2, *I1.shape)) if background is None else background
    if I1.shape != I2.shape or u_bg.shape != (2, *I1.shape):
        raise InputError(
            f"images of shapes {I1.shape} and {I2.shape} and a background of {u_bg.shape[1:]}"
            " differ in size; crop or resample them to one"
        )
    x, motion = as_arrays(bubbles, I1.shape)
    motion = motion - evaluate_field(u_bg, x)
    found: list[Estimate] = []
    weights = [settings.alpha] if settings.alpha else []

    def improve(grid: Grid, I1: Array, I2: Array, u: Array) -> Array:
        pair = ImagePair(grid, I1, I2, resize_field(u_bg, grid.shape))
        space = Splines(grid, settings.knots, settings.zero_edges)
        u = u if found else pair.background
        scales_left = scales - 1 - len(found)
        beta = settings.beta if scales_left else 0.0
        speckle = speckle_term(grid, x, motion, beta, settings.sigma)
        for warps in range(settings.warps):
            enough = pair.I1.size >= BLOCKS * settings.block**2 or not scales_left
            if scales_left < 2 and enough and warps == 1 and not settings.alpha:
                near = {"alpha_start": max(weights, default=settings.alpha_start)}
                weights.append(choose_alpha(pair, space, u, settings.model_copy(update=near)))
            alpha = max(weights, default=settings.alpha_start)
            minimum = space.minimise(speckle + pair.density(u), alpha)
            u = pair.background + minimum.v
        found.append(Estimate(u, alpha, float(np.sqrt(pair.misfit(u))), minimum))
        return u

    I1, I2 = normalise(I1, I2, settings.limits)
    scales = _scales(I1.shape, settings)
    coarse_to_fine(I1, I2, improve, scales=scales, factor=settings.factor, progress=progress)
    return found[-1]


def _scales(shape: tuple[int, ...], settings: Preset) -> int:
    """Return the scales wanted, or as many as the image can have."""
    for scales in range(settings.scales, 1, -1):
        try:
            pyramid((shape[0], shape[1]), scales, settings.factor)
        except InputError:
            continue
        return scales
    return 1
