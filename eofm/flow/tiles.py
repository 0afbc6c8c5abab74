"""Parts of a volume, or of an image, that are estimated one by one, and how they fit together.

A tile has a core, which it shares with no other, and around it an overlap that swallows what its
edges do: the field is free there, though the sample goes on. What is chosen from images is chosen
once, on probes, and given to all tiles, and all of them start from one coarser field; so two tiles
say the same where they overlap, up to what the data beyond the overlap would tell. There fields
pass over smoothly into each other.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from eofm.errors import InputError
from eofm.flow.found import Estimate
from eofm.flow.images import COARSE, FINEST, image_pair
from eofm.flow.matching import Match, Overall
from eofm.flow.multigrid import multigrid
from eofm.flow.pair import ImagePair
from eofm.flow.problem import ROUGH, Level, Problem, nothing
from eofm.flow.trust import Trust, judge
from eofm.flow.weight import (
    RIDGE,
    Blocks,
    Trial,
    best_weight,
    enough,
    first_alpha,
    folds,
)
from eofm.grid import Array, Edge, Grid, Mask, faces
from eofm.imaging.greys import grown
from eofm.imaging.intensity import normalise_locally
from eofm.imaging.splines import needed, resize_part

# Samples of the image after compression beyond what the start says that the motion needs.
BEYOND = 8
# Widths of a Gaussian that count.
FAR = 4
# Side of the parts on which the weight of a large scale is chosen, and of one that is not, samples.
PROBE, LARGE = 64, 96

Window = tuple[slice, ...]
# Images before and after compression, and what is live of them, in a window of each.
Read = Callable[[int, Window], tuple[Array, Mask]]


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


@dataclass(frozen=True)
class Scale:
    """One grid of a whole volume that is solved in parts.

    Attributes
    ----------
    problem : Problem
        That of the whole, without background and bubbles.
    number : int
        Of the grid in it.
    read : callable
        ``read(k, window)`` gives the first (0) or second (1) image and where it carries data.
    spreads : sequence of float
        Standard deviations of the whole images.
    overall : Overall
        What is known of them beside that.
    """

    problem: Problem
    number: int
    read: Read
    spreads: Sequence[float]
    overall: Overall = field(default_factory=Overall)

    @property
    def grid(self) -> Grid:
        """The whole one."""
        return self.problem.grids[self.number]

    @property
    def fine(self) -> bool:
        """Whether brightness is fitted on it."""
        return self.number >= len(self.problem.grids) - FINEST

    def level(self, region: Window, start: Array) -> Level:
        """The problem on a region, whose edges are those of the whole or free.

        ``start``, shape (ndim, ...), is a field on the region, in true lengths.
        """
        problem, n = self.problem, self.number
        grid = Grid(shape_of(region), self.grid.spacing)
        on = faces(grid.ndim)
        edges: dict[Edge, Array] = {}
        for edge, v in problem.v_edges.items():
            axis = on[edge].axis(grid.ndim)
            here, whole = region[axis], self.grid.shape[axis]
            if (here.stop == whole) if on[edge].last else (here.start == 0):
                edges[edge] = v
        grids = [*problem.grids[:n], grid, *problem.grids[n + 1 :]]
        part = replace(problem, grids=grids, u_bg=nothing(grid.shape), v_edges=edges)
        level = part.level(n, self.pair(region, start), start)
        return replace(level, decides=False)

    def pair(self, region: Window, start: Array) -> ImagePair:
        """The images on a region, the second as far around as the motion asks."""
        settings, grid = self.problem.settings, Grid(shape_of(region), self.grid.spacing)
        motion, after = grid.samples(start), []
        for part, n, u in zip(region, self.grid.shape, motion[::-1], strict=True):
            first = part.start + math.floor(float(u.min())) - BEYOND
            last = part.stop + math.ceil(float(u.max())) + BEYOND
            # Where all has moved out of the volume, a part of it that nothing refers to.
            first = min(max(first, 0), n - 2 * BEYOND) if n > 2 * BEYOND else 0
            after.append(slice(first, max(min(last, n), first + min(n, 2 * BEYOND))))
        (I1, live), (I2, live_after) = self._image(0, region), self._image(1, tuple(after))
        offset = tuple(r.start - a.start for r, a in zip(region, after, strict=True))[::-1]
        images, masks = (I1, I2), (live, live_after)
        return image_pair(grid, images, masks, settings, self.fine, offset, self.overall)

    def _image(self, k: int, window: Window) -> tuple[Array, Mask]:
        if not self.problem.settings.robust or self.fine:
            return self.read(k, window)
        reach = int(FAR * COARSE)
        around, inner = grown(window, reach, self.grid.shape)
        I, live = self.read(k, around)
        J = normalise_locally(I, (COARSE,) * I.ndim, self.spreads[k])
        return np.ascontiguousarray(J[inner]), np.ascontiguousarray(live[inner])


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


class Choice(NamedTuple):
    """What is chosen once for all tiles of a scale.

    Attributes
    ----------
    first, alpha : float
        Of the first solve of the scale, and of the others.
    chosen : tuple of float
        The weights that scales have chosen up to this one.
    reach : float
        Length, samples, that ``alpha`` holds as firmly as the images do.
    overall : mapping
        Numbers of the whole images, see :class:`eofm.flow.matching.Overall`.
    """

    first: float
    alpha: float
    chosen: tuple[float, ...]
    reach: float
    overall: Mapping[str, tuple[float, ...]]


def choose(
    scale: Scale,
    tiles: Sequence[Tile],
    starts: Callable[[Window], Array],
    chosen: tuple[float, ...],
) -> Choice:
    """What all tiles of a scale are to have alike, from some parts of it.

    Parameters
    ----------
    scale : Scale
    tiles : sequence of Tile
        Those of `probes`.
    starts : callable
        Gives the field in a window of the scale's grid to start from.
    chosen : tuple of float
        The weights that coarser scales have chosen.
    """
    settings, number = scale.problem.settings, scale.number
    found = []
    for tile in tiles:
        level = scale.level(tile.region, starts(tile.region))
        found.append((level, _near(level, chosen[-1] if chosen else None)))
    matches, overall = _alike(found, settings.denoising)
    parts = []
    for tile, (level, _), match in zip(tiles, found, matches, strict=True):
        fields = (level.base[:, *tile.inner], level.prescribed[:, *tile.inner])
        parts.append((_part(match, tile.inner), *fields, level.free[tile.inner]))
    strength = float(np.mean([part[0].strength for part in parts]))
    last = chosen[-1] if chosen else None
    first = settings.alpha or last or float(np.mean([first_alpha(part[0]) for part in parts]))
    alpha = first
    finest = number == len(scale.problem.grids) - 1
    decides = number >= len(scale.problem.grids) - 2 and enough(scale.grid.shape, finest)
    if settings.alpha is None and decides:
        held = folds(scale.grid.shape, len(tiles))

        def trials(blocks: Blocks) -> list[Trial]:
            return [
                Trial(*part, fold, RIDGE * strength, np.ones_like(part[0].r), blocks)
                for part in parts
                for fold in held
            ]

        choice, _ = best_weight(trials, alpha, chosen)
        alpha, chosen = choice.alpha, (*chosen, choice.best)
    reach = (alpha / (strength + np.finfo(float).tiny)) ** 0.25
    return Choice(first, alpha, chosen, float(reach) / scale.grid.side, overall)


def _near(level: Level, alpha: float | None) -> Array:
    """A field whose residual is noise: what the first solve of a scale gives."""
    settings, u = level.problem.settings, level.coarse
    if settings.warps > 1:
        match = level.pair.linearise(u)
        alpha = settings.alpha or alpha or first_alpha(match)
        about = level.base + level.prescribed
        F = level.functional(match, alpha)
        u = about + multigrid(F, change=ROUGH, initial=u - about)
    return u


def _alike(
    found: Sequence[tuple[Level, Array]], denoising: float | None
) -> tuple[list[Match], dict[str, tuple[float, ...]]]:
    """The images of parts linearised about fields, with the same numbers for all, and those.

    The mean weight is that under variances which are alike already.
    """
    overall: dict[str, tuple[float, ...]] = {}
    for names in (("spreads", "white", "gradient", "variances"), ("weight",)):
        noted: list[dict[str, tuple[float, ...]]] = []
        for level, u in found:
            pair = replace(level.pair, overall=Overall(overall))
            pair.linearise_near(u, denoising)
            noted.append(pair.overall.noted)
        for name in names:
            values = [part[name] for part in noted if name in part]
            if values:
                overall[name] = tuple(float(v) for v in np.mean(values, axis=0))
    near = [
        replace(level.pair, overall=Overall(overall)).linearise_near(u, denoising)
        for level, u in found
    ]
    return near, overall


def _part(match: Match, window: Window) -> Match:
    grid = Grid(shape_of(window), match.grid.spacing)
    u, g = (np.ascontiguousarray(f[:, *window]) for f in (match.u, match.g))
    r, used = np.ascontiguousarray(match.r[window]), np.ascontiguousarray(match.used[window])
    return Match(grid, u, g, r, used)


class Solved(NamedTuple):
    """What a tile gives.

    Attributes
    ----------
    u : ndarray, shape (ndim, ...)
        The field on its region, in true lengths.
    trust : Trust
        What the images say of its core.
    deviation : ndarray, shape (ndim, ...), or None
        The standard deviation of the field, samples.
    """

    u: Array
    trust: Trust
    deviation: Array | None


def solve(scale: Scale, tile: Tile, start: Array, choice: Choice, draws: int, seed: int) -> Solved:
    """Estimate a tile of a scale.

    Parameters
    ----------
    scale : Scale
    tile : Tile
    start : ndarray, shape (ndim, ...)
        A field on its region, in true lengths.
    choice : Choice
    draws : int
        Samples for the standard deviation; none if 0.
    seed : int
        Of them.
    """
    level = replace(scale, overall=Overall(choice.overall)).level(tile.region, start)
    u = _near(level, choice.first)
    # One solve is done.
    settings = level.problem.settings
    settings = settings.changed(warps=max(1, settings.warps - 1))
    rest = replace(level, problem=replace(level.problem, settings=settings), coarse=u)
    better = rest.improve((choice.alpha,), False)
    u, edges = better.u, tuple(level.problem.v_edges)
    samples = level.pair.grid.samples(u)
    deviation = None
    if draws:
        found = Estimate(
            samples,
            better.alpha,
            level.pair,
            settings.denoising,
            better.functional,
            level.base,
            better.ease,
            np.zeros(samples.shape[1:], dtype=bool),  # a tile does not see frames
            scale.grid.spacing,
        )
        deviation = found.deviation(draws, seed)
    match, inner = replace(level.pair, robust=False).linearise(u), tile.inner
    I1, used = level.pair.I1[inner], match.used[inner]
    trust = judge(I1, I1 + match.r[inner], used, samples[:, *inner], edges)
    return Solved(u, trust, deviation)


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
