"""Parts of a grid that are estimated one by one, and how they fit together.

A tile has a core, which it shares with no other, and around it an overlap that swallows what its
edges do. Where two overlap, their fields pass over smoothly into each other.
"""

import math
from collections.abc import Callable, Sequence
from functools import reduce
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array
from eofm.imaging.greys import grown
from eofm.imaging.splines import needed, resize_part

# Side of the parts on which the weight of a large scale is chosen, and of one that is not, samples.
PROBE, LARGE = 64, 96

Window = tuple[slice, ...]


class Tile(NamedTuple):
    """A part of a grid, and the part around it that is estimated with it.

    Attributes
    ----------
    core, region : tuple of slice
    """

    core: Window
    region: Window

    @property
    def inner(self) -> Window:
        """The core in an array of the region."""
        sides = zip(self.core, self.region, strict=True)
        return tuple(slice(c.start - r.start, c.stop - r.start) for c, r in sides)

    def weights(self, shape: tuple[int, ...], overlap: int) -> list[Array]:
        """Along each axis of the region, the part of it in the whole field, of a ``shape``.

        From 0 to 1 over the width of the overlap about each seam, such that all tiles together
        have the weight 1, with two continuous derivatives.
        """
        along = []
        for n, core, region in zip(shape, self.core, self.region, strict=True):
            x, w = np.arange(region.start, region.stop), np.ones(region.stop - region.start)
            if core.start > 0:
                w *= _step((x - core.start + 0.5) / overlap + 0.5)
            if core.stop < n:
                w *= _step((core.stop - 0.5 - x) / overlap + 0.5)
            along.append(w)
        return along


def _step(t: Array) -> Array:
    """From 0 at 0 to 1 at 1, and ``step(t) + step(1 - t) = 1``."""
    t = np.clip(t, 0, 1)
    return t**3 * (10 + t * (6 * t - 15))


def cut(shape: tuple[int, ...], counts: Sequence[int], overlap: int) -> list[Tile]:
    """Tiles of a grid, so many along each axis, that reach into each other by an overlap.

    Raises
    ------
    InputError
        If they are too small for it.

    Examples
    --------
    >>> [tile.region for tile in cut((100, 40), (2, 1), 10)]
    [(slice(0, 60, None), slice(0, 40, None)), (slice(40, 100, None), slice(0, 40, None))]
    """
    sides = []
    for n, count in zip(shape, counts, strict=True):
        ends = [n * k // count for k in range(count + 1)]
        if count > 1 and n // count < 2 * overlap:
            raise InputError(
                f"tiles: {count} of them leave {n // count} px each along a side of {n} px, less"
                f" than twice the overlap of {overlap} px; use fewer, or a smaller overlap"
            )
        sides.append(
            [
                (slice(a, b), slice(max(a - overlap, 0), min(b + overlap, n)))
                for a, b in pairwise(ends)
            ]
        )
    return [
        Tile(tuple(core for core, _ in part), tuple(region for _, region in part))
        for part in product(*sides)
    ]


def tiled_scales(counts: Sequence[int], factor: float) -> int:
    """How many scales are solved in tiles: so many that all the others are as small as one tile.

    It follows from their numbers along the axes and the ratio of two scales alone.

    Examples
    --------
    >>> tiled_scales((2, 2, 2), 0.5), tiled_scales((4, 4, 1), 0.5)
    (1, 2)
    """
    cut_along = [count for count in counts if count > 1]
    sides = math.log(math.prod(cut_along)) / max(len(cut_along), 1)
    return max(1, math.ceil(sides / -math.log(factor) - 1e-9))


def counts_at(counts: Sequence[int], level: int, factor: float) -> tuple[int, ...]:
    """Numbers of tiles on the scale that is so many levels coarser than the finest."""
    return tuple(max(1, math.ceil(count * factor**level - 1e-9)) for count in counts)


def probes(shape: tuple[int, ...], overlap: int) -> list[Tile]:
    """Parts of a grid on which weights are chosen, in the middles of opposite quarters."""

    def cuts(n: int) -> list[slice]:
        if n <= LARGE:
            return [slice(0, n)]
        starts = (int(np.clip(c - PROBE // 2, 0, n - PROBE)) for c in (n // 4, 3 * n // 4))
        return [slice(start, start + PROBE) for start in starts]

    sides = [cuts(n) for n in shape]
    cores = [tuple(side[k % len(side)] for side in sides) for k in range(max(map(len, sides)))]
    return [Tile(core, grown(core, overlap, shape)[0]) for core in cores]


def shape_of(window: Window) -> tuple[int, ...]:
    """Return the shape of a window."""
    return tuple(w.stop - w.start for w in window)


def carried(
    read: Callable[[Window], Array],
    coarse: tuple[int, ...],
    shape: tuple[int, ...],
    window: Window,
) -> Array:
    """A window of the field on a grid of a ``shape`` that one on a coarser grid gives.

    ``read(window)`` gives a window of that one, shape (ndim, ...).
    """
    part = needed(coarse, shape, window)
    u = read(part)
    return np.stack([resize_part(c, part, coarse, shape, window, odd=True) for c in u])


def blend(
    field: Array, window: Window, tile: Tile, u: Array, shape: tuple[int, ...], overlap: int
) -> None:
    """Add the part of a tile in a ``window`` of the whole field to it.

    Parameters
    ----------
    field : ndarray, shape (components, ...)
        The whole field in the window.
    u : ndarray
        That of the tile in the part of its region which is in the window.
    """
    both = common(window, tile.region)
    if both is None:
        return
    along = tile.weights(shape, overlap)
    sides = zip(along, both, tile.region, strict=True)
    parts = [w[b.start - r.start : b.stop - r.start] for w, b, r in sides]
    weight = reduce(np.multiply.outer, parts).astype(field.dtype)
    field[:, *Tile(both, window).inner] += weight * u


def common(first: Window, second: Window) -> Window | None:
    """What two windows share, if anything."""
    both = tuple(
        slice(max(a.start, b.start), min(a.stop, b.stop))
        for a, b in zip(first, second, strict=True)
    )
    return both if all(s.start < s.stop for s in both) else None
