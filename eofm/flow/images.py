"""The two images as the estimate sees them, on each of its grids."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from eofm.flow.known import Known
from eofm.flow.matching import Overall
from eofm.flow.pair import ImagePair
from eofm.flow.pyramid import sampled
from eofm.grid import Array, Grid, Mask, precision, unit_spacing
from eofm.imaging.carrier import amplitude, has_carrier
from eofm.imaging.defects import defects, filled
from eofm.imaging.intensity import normalise, normalise_locally
from eofm.imaging.splines import resize
from eofm.settings import Estimation

# The finest scales, on which brightness is fitted and residuals are weighed; and the window in
# which the images of coarser ones are normalised, samples of each.
FINEST, COARSE = 2, 8.0


@dataclass(frozen=True)
class Images:
    """Images, or volumes, and what of them shows no sample.

    Attributes
    ----------
    I1, I2 : ndarray, shape (height, width) or (depth, height, width)
        Before and after compression.
    dead, dead_after : ndarray of bool
        Pixels that carry no data, in I1 and in I2.
    """

    I1: Array
    I2: Array
    dead: Mask
    dead_after: Mask

    @classmethod
    def of(cls, I1: Array, I2: Array, settings: Estimation, known: Known) -> Self:
        """Return them with dead zones and, with ``settings.robust``, defects left out."""
        dead = known.dead_on(I1.shape)
        if not settings.robust:
            return cls(I1, I2, dead, dead)
        J1, J2 = normalise(I1, I2)
        before, after = dead | defects(filled(J1, dead)), dead | defects(filled(J2, dead))
        return cls(filled(I1, before), filled(I2, after), before, after)

    @property
    def oscillate(self) -> bool:
        """Whether both have a carrier, see :mod:`eofm.imaging.carrier`."""
        return has_carrier(self.I1) and has_carrier(self.I2)

    @property
    def amplitudes(self) -> Self:
        """Those of their carriers in their place."""
        J1, J2 = (amplitude(J) for J in normalise(self.I1, self.I2))
        return replace(self, I1=J1, I2=J2)

    def pairs(self, grids: list[Grid], settings: Estimation, known: Known) -> list[ImagePair]:
        """Return them on grids from coarse to fine.

        With ``settings.robust``, brightness and contrast are normalised locally on all but the two
        finest.
        """
        sides = known.sides(self.I1.ndim)
        images = [sampled(I, grids) for I in normalised(self.I1, self.I2, settings, sides)]
        pairs = []
        for number, (grid, J1, J2) in enumerate(zip(grids, *images, strict=True)):
            fine = number >= len(grids) - FINEST
            if settings.robust and not fine:
                J1, J2 = (normalise_locally(J, (COARSE,) * J.ndim) for J in (J1, J2))
            live, live_after = (~resized(m, grid.shape) for m in (self.dead, self.dead_after))
            pairs.append(image_pair(grid, (J1, J2), (live, live_after), settings, fine))
        return pairs


def image_pair(
    grid: Grid,
    images: tuple[Array, Array],
    live: tuple[Mask, Mask],
    settings: Estimation,
    fine: bool,
    offset: tuple[int, ...] = (),
    overall: Overall | None = None,
) -> ImagePair:
    """Images on a grid, and how they are compared there; ``fine`` grids fit brightness."""
    mean, robust = settings.gradients == "mean", settings.robust and fine
    return ImagePair(
        grid, *images, *live, mean, robust, settings.robust, offset, overall or Overall()
    )


def normalised(
    I1: Array, I2: Array, settings: Estimation, pixel_size: tuple[float, ...]
) -> tuple[Array, Array]:
    """The images as the estimate sees them, of pixels with some sides."""
    I1, I2 = normalise(I1, I2, settings.limits if settings.local_window is None else None)
    settings.check_widths(I1.shape)
    if settings.local_window is None:
        return I1, I2
    window = tuple(settings.local_window / h for h in unit_spacing(pixel_size))
    return normalise_locally(I1, window), normalise_locally(I2, window)


def resized(mask: Mask, shape: tuple[int, ...]) -> Mask:
    """A mask on another grid."""
    if not mask.any():
        return np.zeros(shape, dtype=bool)
    return resize(mask.astype(precision(mask.ndim)), shape) >= 0.5
