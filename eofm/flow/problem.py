"""What is minimised on each scale, and one step of it."""

from dataclasses import dataclass
from typing import NamedTuple, Self, cast

import numpy as np
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.flow.functional import Pointwise, Quadratic, hold_edges, speckle_term
from eofm.flow.known import Known
from eofm.flow.matching import Match
from eofm.flow.multigrid import multigrid
from eofm.flow.pair import ImagePair
from eofm.flow.pyramid import pyramid, solving
from eofm.flow.roughness import ease
from eofm.flow.stated import on_edges
from eofm.flow.trial import REACH, enough, first_alpha, reach
from eofm.flow.weight import choose_alpha
from eofm.grid import (
    FACES,
    Array,
    Edge,
    Grid,
    Mask,
    componentwise,
    faces,
    precision,
)
from eofm.imaging.splines import evaluate_field, resize_field
from eofm.settings import Estimation

# Change of u by the last iteration of a solve whose result stays, px, which leaves a tenth of that;
# and of solves that are followed by another about their result.
FINE, ROUGH = 1e-3, 1e-2
# How much more firmly an edge is held, of which a part alone is known, than images hold the rows
# beside it: what they say against it moves it by a thousandth of a pixel at most.
FIRM = 1e3


@dataclass(frozen=True)
class Problem:
    """All that F is made of beside the images, on the finest grid and in true lengths.

    Attributes
    ----------
    settings : Estimation
    grids : list of Grid
        From coarse to fine, in the unit that gives the pixels of the finest the area 1.
    u_bg : ndarray, shape (ndim, ...)
    v_edges : dict of ndarray, shape (ndim, n, ...)
        ``v`` on the edges of known motion, NaN where it is not known.
    x, motion : ndarray, shape (ndim, M)
        Bubbles and their motion less that of the background.
    part : float
        Of the first weight, which coarse grids take.
    """

    settings: Estimation
    grids: list[Grid]
    u_bg: Array
    v_edges: dict[Edge, Array]
    x: Array
    motion: Array
    part: float = 1.0

    @classmethod
    def of(cls, shape: tuple[int, ...], settings: Estimation, known: Known) -> Self:
        """Return what is known, checked against the size of the images."""
        ndim = len(shape)
        if strange := sorted(set(settings.zero_edges) - set(faces(ndim))):
            raise InputError(f"zero_edges: {strange[0]} is an edge of volumes only")
        spacing = known.spacing(ndim)
        # One scale is no multi-scale scheme, and has the pixels.
        skipped = int(settings.ends == "half" and settings.scales != 1)
        grids = pyramid(shape, settings.scales, settings.factor, spacing, skipped)
        x, motion = known.motions(shape)
        h, u_bg = np.reshape(spacing, (-1, 1)), nothing(shape)
        if known.background is not None:
            motion = motion - evaluate_field(known.background, x)
            u_bg = componentwise(spacing, ndim) * known.background.astype(u_bg.dtype, copy=False)

        def at(edge: Edge) -> Array:
            return u_bg[:, *FACES[edge].pixels(ndim)]

        on = componentwise(spacing, ndim)[..., 0]
        v_edges = {edge: on * g - at(edge) for edge, g in known.edges.items()}
        v_edges |= {edge: np.zeros_like(at(edge)) for edge in settings.zero_edges}
        return cls(settings, grids, u_bg, v_edges, h * x, h * motion)

    def level(self, number: int, pair: ImagePair, u: Array) -> "Level":
        """Return the problem on one of the grids, with the images sampled there.

        ``u`` is the field of the grid before. Where R acts on updates, it takes the part of u_bg.
        """
        settings, grid, finest = self.settings, self.grids[number], number == len(self.grids) - 1
        u_bg = base = resize_field(self.u_bg, grid.shape)
        edges, motion, known = on_edges(grid, self.v_edges), self.motion, []
        if settings.smoothness_of == "update":
            base = self.carried(u, grid.shape)
            v = base - u_bg
            motion = motion - evaluate_field(v, self.x / np.reshape(grid.spacing, (-1, 1)))
            edges = {edge: g - v[:, *FACES[edge].pixels(grid.ndim)] for edge, g in edges.items()}
        if self.x.size and (settings.speckle_scales == "all" or not finest):
            sigma = settings.sigma * (grid.side if settings.lengths == "scale" else 1.0)
            beta = _weights(grid, self.x, self.v_edges, settings, sigma)
            known.append(speckle_term(grid, self.x, motion, beta, sigma))
        last = number >= len(self.grids) - 2
        decides = settings.alpha is None and last and enough(grid.shape, finest)
        weak = bool(settings.edge_weight)
        held = {e: g for e, g in edges.items() if weak or not np.isfinite(g).all()}
        prescribed, free = _prescribed(grid, {e: g for e, g in edges.items() if e not in held})
        still = settings.warped_by == "nothing" or (number == 0 and settings.start == "zero")
        return Level(
            self,
            pair,
            u,
            u_bg,
            base,
            prescribed,
            free,
            held,
            {edge: np.isfinite(g) for edge, g in edges.items()},
            tuple(known),
            decides,
            finest,
            still,
        )

    def carried(self, u: Array, shape: tuple[int, ...]) -> Array:
        """The field of a grid on another one.

        It is ``v`` that is carried, so that u_bg keeps its details and edges their motion, but
        where both are only what the next solve starts from.
        """
        if self.settings.smoothness_of == "v" and self.settings.ends == "full":
            return resize_field(u, shape)
        v = u - resize_field(self.u_bg, u.shape[1:])
        return resize_field(self.u_bg, shape) + resize_field(v, shape)


@dataclass(frozen=True)
class Level:
    """The problem on one grid, but for the displacement about which the images are linearised.

    Attributes
    ----------
    problem : Problem
    pair : ImagePair
    coarse : ndarray, shape (ndim, ...)
        The field of the grid before.
    u_bg : ndarray, shape (ndim, ...)
        The background on this one.
    base : ndarray, shape (ndim, ...)
        The field to which this grid adds ``v``, all of it or an update: u_bg, or what coarser
        grids have made of it.
    prescribed : ndarray, shape (ndim, ...)
        A field that is ``v`` on edges where it is prescribed, 0 elsewhere.
    free : ndarray of bool
        The other pixels.
    held : dict of ndarray, shape (ndim, n, ...)
        ``v`` on edges that a penalty holds, as the settings ask or because it is known in part
        alone; NaN where it is not.
    stated : dict of ndarray of bool, shape (ndim, n, ...)
        What is known of the motion of edges.
    terms : tuple of Pointwise
        The speckle term.
    decides, finest : bool
        Whether alpha is chosen on it; whether it is the last one.
    still : bool
        Whether the images are linearised about no motion first.
    ease : ndarray, optional
        By which alpha is divided at each pixel, where it is not chosen on this grid.
    """

    problem: Problem
    pair: ImagePair
    coarse: Array
    u_bg: Array
    base: Array
    prescribed: Array
    free: Mask
    held: dict[Edge, Array]
    stated: dict[Edge, Mask]
    terms: tuple[Pointwise, ...]
    decides: bool
    finest: bool
    still: bool
    ease: Array | None = None

    def functional(self, match: Match, alpha: float, factor: Array | None = None) -> Quadratic:
        """F of ``v`` less what is prescribed; ``factor`` multiplies all terms but R."""
        terms = sum(self.terms, start=match.density(self.base))
        if self.held:
            firm = FIRM * REACH * self.pair.grid.side * match.strength
            weight = self.problem.settings.edge_weight or firm
            hold_edges(terms, self.pair.grid, self.held, weight)
        terms = terms if factor is None else terms.times(factor)
        F = Quadratic(self.pair.grid, terms, alpha, self.free, self.problem.settings.smoothness)
        return F.shifted(self.prescribed)

    def improve(self, chosen: tuple[float, ...], progress: bool) -> "Improved":
        """Return a better displacement, in true lengths.

        ``chosen`` are the weights that coarser grids have chosen.
        """
        settings, F = self.problem.settings, cast(Quadratic, None)
        factor, weight = self.ease, settings.alpha
        u = self.problem.carried(self.coarse, self.pair.grid.shape)
        about = self.base + self.prescribed if self.prescribed.any() else self.base
        # The first field of a scale may still be far from it, and its residual no noise.
        near = min(1, settings.warps - 1)
        for warp in range(settings.warps):
            del F  # what is not needed any more makes room: of volumes it is the half
            match = self._linearised(u, self.still and warp == 0, warp >= near)
            first = chosen[-1] if chosen else first_alpha(match)
            alpha = weight or (first if chosen else self.problem.part * first)
            if self.decides and warp == near:
                if self.pair.robust and self.pair.grid.ndim == 2:
                    seen = (match.g**2).sum(0) * match.used
                    factor = ease(u - self.base, self.pair.grid, seen, reach(match, first))
                choice = choose_alpha(
                    match, self.base, self.prescribed, self.free, first, chosen, factor
                )
                chosen, weight = (*chosen, choice.best), choice.alpha
                alpha = weight
                factor = factor if choice.eased else None
            F = self.functional(match, alpha, factor)
            del match
            last = warp == settings.warps - 1 and (
                self.finest or settings.smoothness_of == "update"
            )
            change = FINE if last else ROUGH
            # Of which nobody keeps a copy while the next one is found.
            start = [u - about]
            del u
            with solving(self.pair.grid, progress) as report:
                u = about + multigrid(F, change=change, initial=start.pop(), report=report)
        return Improved(u, alpha, F, chosen, factor)

    def _linearised(self, u: Array, still: bool, near: bool) -> Match:
        """The images linearised about what I2 is warped by."""
        settings = self.problem.settings
        by = u - self.u_bg if settings.warped_by == "v" else u
        by = nothing(self.pair.grid.shape) if still else by
        denoising = settings.denoising
        return self.pair.linearise_near(by, denoising) if near else self.pair.linearise(by)


class Improved(NamedTuple):
    """What one grid gives.

    ``u`` in true lengths, its alpha, its F, the weights chosen so far, and by what all terms of F
    but R were multiplied.
    """

    u: Array
    alpha: float
    functional: Quadratic
    chosen: tuple[float, ...]
    ease: Array | None


def nothing(shape: tuple[int, ...]) -> Array:
    """A field that is zero and takes no memory."""
    return np.broadcast_to(np.zeros((), precision(len(shape))), (len(shape), *shape))


def _prescribed(grid: Grid, edges: dict[Edge, Array]) -> tuple[Array, NDArray[np.bool_]]:
    """A field that is ``v`` on the edges where it is prescribed, and the other pixels."""
    p, free = nothing(grid.shape), np.ones(grid.shape, dtype=bool)
    if edges:
        p = p.copy()
    for edge, v in edges.items():
        pixels = FACES[edge].pixels(grid.ndim)
        p[:, *pixels] = v
        free[pixels] = False
    return p, free


def _weights(
    grid: Grid, x: Array, known: dict[Edge, Array], settings: Estimation, sigma: float
) -> NDArray[np.float64]:
    """The weights beta_i, raised near edges whose motion is not known."""
    unknown = (face for edge, face in faces(grid.ndim).items() if edge not in known)
    near = [face.distance(x, grid) < 2 * sigma for face in unknown]
    factor = np.where(np.any(near, axis=0), settings.edge_bubbles, 1.0) if near else 1.0
    return settings.beta * np.broadcast_to(factor, x.shape[1:])
