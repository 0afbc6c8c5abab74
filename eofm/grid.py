"""The ground floor: grids of pixels, their axes and their faces. It knows no method.

The convention, stated here once, for images and for volumes:

- Array axes are (elevational,) axial, lateral: ``shape`` is (height, width), or (depth, height,
  width). Axial positions grow downwards.
- Components run the other way: component c of a field belongs to array axis ``ndim - 1 - c``.
  So ``u[0] = u1`` is lateral, ``u[1] = u2`` axial, and a volume adds ``u[2] = u3``, elevational.
  What holds a value for each component (``spacing``, ``axes``, ``weights``, ``lengths``, pixel
  sizes, points ``x``) is ordered as components are: lateral first.
- The first pixel's centre is the origin, and the sample ends at the centres of the outer pixels.
- Images and their fields have double precision, volumes and theirs single.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Double precision, or single where it holds a volume.
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Edge = Literal["top", "bottom", "left", "right", "front", "back"]


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

    def sides(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Pixels along each of its sides, in the order of the axes, of a grid of a shape."""
        axis = self.axis(len(shape))
        return shape[:axis] + shape[axis + 1 :]


# Where two meet, what they share belongs to the later one.
FACES: dict[Edge, Face] = {
    "front": Face(2, False),
    "back": Face(2, True),
    "left": Face(0, False),
    "right": Face(0, True),
    "top": Face(1, False),
    "bottom": Face(1, True),
}


def faces(ndim: int) -> dict[Edge, Face]:
    """Those of a grid with ``ndim`` axes, in the order of `FACES`."""
    return {edge: face for edge, face in FACES.items() if face.component < ndim}


def precision(ndim: int) -> type[np.floating[Any]]:
    """Type of the numbers in images (two axes) and volumes (three), and in their fields."""
    return np.float32 if ndim == 3 else np.float64


@dataclass(frozen=True)
class Grid:
    """Pixel centres of an image or a volume: their number and their distances.

    Attributes
    ----------
    shape : tuple of int
        (height, width) or (depth, height, width)
    spacing : tuple of float
        (h1, h2) or (h1, h2, h3), lateral, axial and elevational distance, by default 1;
        greater on the coarse scales.
    """

    shape: tuple[int, ...]
    spacing: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.spacing:
            object.__setattr__(self, "spacing", (1.0,) * len(self.shape))

    @property
    def side(self) -> float:
        """Geometric mean of the distances."""
        return geometric_mean(self.spacing)

    def samples(self, u: Array) -> Array:
        """A displacement in samples, maybe itself, of one in the unit of the distances."""
        return u if set(self.spacing) == {1.0} else u / componentwise(self.spacing, self.ndim)

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
    return np.reshape(np.asarray(values, dtype=precision(ndim)), (-1, *[1] * ndim))


def inside(shape: tuple[int, ...], x: Array) -> Mask:
    """Where points, shape (ndim, ...) in pixels, lie in an image of a shape."""
    within = [(c >= 0) & (c <= n - 1) for c, n in zip(x, shape[::-1], strict=True)]
    return reduce(np.logical_and, within)


def geometric_mean(sides: Sequence[float]) -> float:
    """Side of the square or cube that is as large as a pixel with some sides."""
    root = np.sqrt if len(sides) == 2 else np.cbrt
    return float(root(np.prod(sides)))


def unit_spacing(pixel_size: Sequence[float]) -> tuple[float, ...]:
    """Sides of a pixel in the unit that gives it the area or volume 1."""
    side = geometric_mean(pixel_size)
    return tuple(float(size / side) for size in pixel_size)


def along_face(profile: Array, *parts: Array) -> Array:
    """Values at parts, from 0 to 1, of the sides of a face that a profile divides evenly.

    Parameters
    ----------
    profile : ndarray, shape (components, n, ...)
        Values at n points from one end of a side to the other; n = 1 is constant.
    *parts : ndarray, shape (k,)
        For each side, in the order of the axes.

    Returns
    -------
    ndarray, shape (components, k, ...)
    """
    for axis, part in enumerate(parts, 1):
        at = np.linspace(0, 1, profile.shape[axis])
        lines = np.moveaxis(profile, axis, -1)
        values = [np.interp(part, at, line) for line in lines.reshape(-1, lines.shape[-1])]
        profile = np.moveaxis(np.reshape(values, (*lines.shape[:-1], -1)), -1, axis)
    return profile
