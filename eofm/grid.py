"""The ground floor: grids of pixels, their axes and their faces. It knows no method.

The convention, stated here once, for images and for volumes:

- Array axes are (elevational,) axial, lateral: ``shape`` is (height, width), or (depth, height,
  width). Axial positions grow downwards.
- Components run the other way: component c of a field belongs to array axis ``ndim - 1 - c``.
  So ``u[0] = u1`` is lateral, ``u[1] = u2`` axial, and a volume adds ``u[2] = u3``, elevational.
  What holds a value for each component (``spacing``, ``axes``, ``weights``, ``lengths``, pixel
  sizes, points ``x``) is ordered as components are: lateral first.
- The first pixel's centre is the origin, and the sample ends at the centres of the outer pixels.
"""

from dataclasses import dataclass
from functools import reduce
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Edge = Literal["top", "bottom", "left", "right"]


class Face(NamedTuple):
    """A side of a grid: the pixels where the position along one component ends.

    Attributes
    ----------
    component : int
        The component that is normal to it.
    last : bool
        Whether positions end there, or begin.
    """

    component: int
    last: bool

    def axis(self, ndim: int) -> int:
        """Array axis that is normal to it."""
        return ndim - 1 - self.component

    def pixels(self, ndim: int = 2) -> tuple[int | slice, ...]:
        """Index of its pixels in an array of a grid with ``ndim`` axes."""
        index: list[int | slice] = [slice(None)] * ndim
        index[self.axis(ndim)] = -1 if self.last else 0
        return tuple(index)

    def distance(self, x: Array, grid: "Grid") -> Array:
        """Distance of points, shape (ndim, ...), from it."""
        c = x[self.component]
        return grid.lengths[self.component] - c if self.last else c

    def along(self, shape: tuple[int, ...]) -> int:
        """Pixels along it, of an image of a shape (height, width)."""
        return shape[1 - self.axis(2)]


# Where two meet, the corner belongs to the later one.
FACES: dict[Edge, Face] = {
    "left": Face(0, False),
    "right": Face(0, True),
    "top": Face(1, False),
    "bottom": Face(1, True),
}


@dataclass(frozen=True)
class Grid:
    """Pixel centres of an image: their number and their distances.

    Attributes
    ----------
    shape : tuple of int
        (height, width)
    spacing : tuple of float
        (h1, h2), lateral and axial distance; greater than 1 on the coarse scales.
    """

    shape: tuple[int, int]
    spacing: tuple[float, float] = (1.0, 1.0)

    @property
    def ndim(self) -> int:
        """Number of axes, and of components."""
        return len(self.shape)

    @property
    def axes(self) -> list[Array]:
        """Positions of the pixels along each component."""
        sides = zip(self.shape[::-1], self.spacing, strict=True)
        return [h * np.arange(n, dtype=np.float64) for n, h in sides]

    @property
    def lengths(self) -> list[float]:
        """Distance of the outer pixels along each component."""
        return [(n - 1) * h for n, h in zip(self.shape[::-1], self.spacing, strict=True)]

    @property
    def weights(self) -> list[Array]:
        """Trapezoidal weights along each component."""
        sides = zip(self.shape[::-1], self.spacing, strict=True)
        weights = [np.full(n, float(h)) for n, h in sides]
        for w in weights:
            w[[0, -1]] /= 2
        return weights

    @property
    def areas(self) -> Array:
        """Part of the sample that belongs to each pixel, of the grid's shape."""
        return reduce(np.multiply.outer, self.weights[::-1])


def componentwise(values: object, ndim: int) -> Array:
    """One value for each component, shaped to act on a field of a grid with ``ndim`` axes."""
    return np.reshape(np.asarray(values, dtype=np.float64), (-1, *[1] * ndim))


def inside(shape: tuple[int, ...], x: Array) -> Mask:
    """Where points, shape (ndim, ...) in pixels, lie in an image of a shape."""
    within = [(c >= 0) & (c <= n - 1) for c, n in zip(x, shape[::-1], strict=True)]
    return reduce(np.logical_and, within)


def unit_spacing(pixel_size: tuple[float, float]) -> tuple[float, float]:
    """Sides of a pixel in the unit that gives it the area 1."""
    side = np.sqrt(np.prod(pixel_size))
    return float(pixel_size[0] / side), float(pixel_size[1] / side)


def along_edge(profile: Array, part: Array) -> Array:
    """Values at parts, from 0 to 1, of an edge along which a profile divides it evenly.

    Parameters
    ----------
    profile : ndarray, shape (components, n)
        Values at n points from one end to the other; n = 1 is constant.
    part : ndarray, shape (k,)

    Returns
    -------
    ndarray, shape (components, k)
    """
    at = np.linspace(0, 1, profile.shape[1])
    return np.stack([np.interp(part, at, c) for c in profile])
