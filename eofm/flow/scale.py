"""One grid of a volume, or of an image, that is solved in tiles.

The field is free at the sides of a tile, though the sample goes on. What is chosen from images is
chosen once, on probes, and given to all tiles, and all of them start from one coarser field; so two
tiles say the same where they overlap, up to what the data beyond the overlap would tell.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from eofm.flow.found import Estimate
from eofm.flow.images import COARSE, FINEST, image_pair
from eofm.flow.matching import Match, Overall
from eofm.flow.multigrid import multigrid
from eofm.flow.pair import ImagePair
from eofm.flow.problem import ROUGH, Level, Problem, nothing
from eofm.flow.tiles import Tile, Window, shape_of
from eofm.flow.trial import RIDGE, Blocks, Trial, enough, first_alpha, folds
from eofm.flow.trust import Told, Trust, judge
from eofm.flow.weight import best_weight
from eofm.grid import Array, Edge, Grid, Mask, faces
from eofm.imaging.greys import grown
from eofm.imaging.intensity import normalise_locally

# Samples of the image after compression beyond what the start says that the motion needs.
BEYOND = 8
# Widths of a Gaussian that count.
FAR = 4

# Images before and after compression, and what is live of them, in a window of each.
Read = Callable[[int, Window], tuple[Array, Mask]]


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
    u, samples = better.u, level.pair.grid.samples(better.u)
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
        level.stated,
    )
    deviation = found.deviation(draws, seed) if draws else None
    I1, warped, used, moved = found.carried_back()
    inner = tile.inner
    told = Told(found.contradictions, found.spread, found.standing.pull, float(found.flickers))
    trust = judge(I1[inner], warped[inner], used[inner], moved[:, *inner], told)
    return Solved(u, trust, deviation)
