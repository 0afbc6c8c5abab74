"""Three orthogonal sections of a volume as one picture; an image is its own.

From in front (axial over lateral), to its right from the side (axial over elevational), and below
from above (elevational over lateral), in true proportions.
"""

from dataclasses import dataclass

import numpy as np

from eofm.grid import Array

# Room between two sections, as a part of the longest side.
GAP = 0.04


@dataclass(frozen=True)
class Sections:
    """The sections of a volume that is not in memory itself.

    Attributes
    ----------
    shape : tuple of int
        That of the volume.
    front, side, above : ndarray
        Axial over lateral, elevational over axial, elevational over lateral.
    """

    shape: tuple[int, ...]
    front: Array
    side: Array
    above: Array
    ndim = 3

    def values(self) -> Array:
        """Return all values in a row."""
        return np.concatenate([s.ravel() for s in (self.front, self.side, self.above)])

    def times(self, factor: float) -> "Sections":
        """Return the same in another unit."""
        parts = (factor * s for s in (self.front, self.side, self.above))
        return Sections(self.shape, *parts)


def middle(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Index of the pixel in which the sections meet."""
    return tuple(n // 2 for n in shape)


def picture(
    values: Array | Sections, pixel_size: tuple[float, ...], at: tuple[int, ...] | None = None
) -> Array:
    """An image as it is, or the sections of a volume side by side.

    Parameters
    ----------
    values : ndarray, shape (height, width) or (depth, height, width), or Sections
    pixel_size : (lateral, axial) or (lateral, axial, elevational)
        Sides of a pixel in any unit.
    at : tuple of int, optional
        Where the sections meet; by default in the middle.

    Returns
    -------
    ndarray, shape (rows, columns)
        Of sections, samples are squares as wide as the shortest side of a voxel; NaN between them.
    """
    if not isinstance(values, Sections):
        if values.ndim == 2:
            return values
        k, j, i = at or middle(values.shape)
        values = Sections(values.shape, values[k], values[:, :, i], values[:, j])
    step = min(pixel_size)
    x, y, z = (
        np.minimum(np.arange(max(1, round(n * p / step))) * step / p, n - 1).astype(np.intp)
        for n, p in zip(values.shape[::-1], pixel_size, strict=True)
    )
    gap = max(2, round(GAP * max(len(x), len(y), len(z))))
    shown = np.full((len(y) + gap + len(z), len(x) + gap + len(z)), np.nan)
    shown[: len(y), : len(x)] = values.front[np.ix_(y, x)]
    shown[: len(y), len(x) + gap :] = values.side.T[np.ix_(y, z)]
    shown[len(y) + gap :, : len(x)] = values.above[np.ix_(z, x)]
    return shown


def side(pixel_size: tuple[float, ...], ndim: int) -> tuple[float, float]:
    """Lateral and axial side of a sample of a picture of an image or volume."""
    return (min(pixel_size),) * 2 if ndim == 3 else (pixel_size[0], pixel_size[1])
