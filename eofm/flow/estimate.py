"""The elastographic optical flow method: all five tests of the paper, and your images."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.flow.functional import Pointwise, Quadratic, edge_term, speckle_term
from eofm.flow.matching import ImagePair, Match, random_signs
from eofm.flow.multigrid import multigrid
from eofm.flow.pyramid import coarse_to_fine, pyramid, solving
from eofm.flow.weight import choose_alpha, enough, first_alpha
from eofm.grid import FACES, Array, Edge, Grid, along_edge, inside, unit_spacing
from eofm.imaging.intensity import normalise, normalise_locally
from eofm.imaging.splines import evaluate_field, resize, resize_field
from eofm.settings import Estimation

if TYPE_CHECKING:
    import pandas as pd


# Change of u by the last iteration of the last solve, px, which leaves a tenth of that; and of
# solves that are followed by another about their result.
FINE, ROUGH = 1e-3, 1e-2


@dataclass(frozen=True)
class Estimate:
    """An estimate and what it came from.

    Attributes
    ----------
    u : ndarray, shape (2, height, width)
        Displacement ``u = u_bg + v``, px, with ``I2(x + u(x)) = I1(x)``: lateral (to the
        right) and axial (down) motion of what was at x before compression.
    alpha : float
        Weight of the smoothness term on the finest scale.
    pair : ImagePair
        The images on the finest scale.
    denoising : float, optional
        Filter of the linearised images, see :meth:`eofm.flow.matching.Match.filtered`.
    functional : Quadratic
        The F that was minimised last.
    """

    u: Array
    alpha: float
    pair: ImagePair
    denoising: float | None
    functional: Quadratic

    @cached_property
    def match(self) -> Match:
        """The images linearised about ``u``, in true lengths."""
        h = np.reshape(self.pair.grid.spacing, (2, 1, 1))
        return self.pair.linearise(h * self.u).filtered(self.denoising)

    def deviation(self, samples: int = 32, seed: int = 0) -> Array:
        """Return the standard deviation of the displacement at each pixel, px.

        Parameters
        ----------
        samples : int
            Number of samples; the relative error of the result is about
            ``1/sqrt(2 samples)``.
        seed : int

        Returns
        -------
        ndarray, shape (2, height, width)
        """
        squares = np.zeros_like(self.u)
        for sample in self.samples(samples, seed):
            squares += sample**2
        return np.sqrt(squares / samples)

    def samples(self, count: int, seed: int = 0) -> Iterator[Array]:
        """Errors of the displacement as they may be, shape (2, height, width), px.

        The deviation of a sample of the posterior from its mean minimises F for data and a
        prior that are noise (Papandreou and Yuille, NIPS 2010). The noise of the data is
        that of the residuals, with one random sign for each block of pixels (wild cluster
        bootstrap, Cameron, Gelbach and Miller, Rev. Econ. Stat. 90, 2008): residuals of
        bubbles are correlated and grow with the gradient, so white noise would promise too
        much. A speckle term on the finest scale (``speckle_scales="all"``) counts as exact.
        """
        rng, F, match = np.random.default_rng(seed), self.functional, self.match
        for _ in range(count):
            noise = random_signs(match.grid.shape, rng) * match.used * match.r
            b = match.g * noise + match.noise * F.rough(rng) / match.grid.areas
            v = multigrid(replace(F, terms=Pointwise(F.terms.A, b)), tol=1e-2)
            yield v / np.reshape(match.grid.spacing, (2, 1, 1))


def estimate_displacement(
    I1: Array,
    I2: Array,
    settings: Estimation = Estimation(),
    *,
    bubbles: "pd.DataFrame | None" = None,
    background: Array | None = None,
    edges: dict[Edge, Array] | None = None,
    dead: NDArray[np.bool_] | None = None,
    pixel_size: tuple[float, float] = (1.0, 1.0),
    progress: bool = False,
) -> Estimate:
    """Displacement between two images by elastographic optical flow.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width)
        Images before and after compression.
    settings : Estimation
        Weights, scales and edges. The defaults are the preset, the most accurate way this
        package has; ``Estimation(method="paper")`` is the paper's.
    bubbles : DataFrame, optional
        Columns x1, x2, u1, u2, px, as ``track`` returns them; without it there is no
        speckle term.
    background : ndarray, shape (2, height, width), optional
        The field u_bg of eq. (Ansatz), px; without it u_bg = 0.
    edges : dict of ndarray, shape (2, n), optional
        Known motion ``g`` of the n pixels of some edges, px, eq. (bdc_Dirichlet).
    dead : ndarray of bool, shape (height, width), optional
        Pixels that carry no data, in both images.
    pixel_size : (lateral, axial)
        Sides of a pixel in any unit. Where they differ, smoothness and sigma are measured
        in true lengths, in units of their geometric mean.
    progress : bool
        Show a progress bar, if standard error is a terminal.

    Returns
    -------
    Estimate
        Its ``u`` is the displacement, shape (2, height, width), px.

    Raises
    ------
    InputError
        If the images are constant, too small for the scales, or differ in size from
        each other, the background or the dead zones, or a bubble lies outside of them.

    Notes
    -----
    On each scale, ``v`` minimises F, eq. (def_F), with I2 linearised about the current
    field ``u0`` (zero or u_bg to start with) by ``I_t = I2(x + u0) - I1 - g . u0``. With one
    scale, one warp, zero to start with and ``g = grad I1`` this is the paper's problem,
    ``I_t = I2 - I1``. Pixels that leave the image, ``x + u0(x)`` outside of it, carry no
    data.

    An alpha that is not given is chosen by cross-validation on the two finest scales. That of
    the finest is taken or, where the other is larger, their geometric mean: residuals that
    are correlated, as those of decorrelated speckle are, make cross-validation choose too
    little smoothing (Opsomer, Wang and Yang, Stat. Sci. 16, 2001), least so on the coarser
    scale.
    """
    background = np.zeros((2, *I1.shape)) if background is None else background
    dead = np.zeros(I1.shape, dtype=bool) if dead is None else dead
    sizes = {I1.shape, I2.shape, background.shape[1:], dead.shape}
    if len(sizes) > 1:
        listed = ", ".join(" x ".join(map(str, size)) for size in sorted(sizes))
        raise InputError(
            f"images, background and dead zones differ in size ({listed} px);"
            " crop or resample them to one"
        )
    # From here on lengths are true, in a unit that gives pixels the area 1.
    h1, h2 = unit_spacing(pixel_size)
    h = np.array([[h1], [h2]])
    u_bg = h[..., None] * background
    v_edges = {edge: h * g - u_bg[:, *FACES[edge].pixels()] for edge, g in (edges or {}).items()}
    v_edges |= {edge: np.zeros_like(u_bg[:, *FACES[edge].pixels()]) for edge in settings.zero_edges}
    x, motion = _arrays(bubbles, I1.shape)
    update = h * (motion - evaluate_field(background, x))
    I1, I2 = normalised(I1, I2, settings, (h1, h2))
    grids = pyramid(I1.shape, settings.scales, settings.factor, (h1, h2))
    known = h * x, update, dead.astype(float)
    problem = _Problem(settings, grids, u_bg, v_edges, *known, progress)
    start = u_bg if settings.start == "background" else None
    coarse_to_fine(I1, I2, problem.improve, grids, start=start, progress=progress)
    assert problem.found is not None  # there is at least one scale
    return problem.found


@dataclass
class _Problem:
    """All that F is made of beside the images, in true lengths.

    Attributes
    ----------
    settings : Estimation
    grids : list of Grid
        From coarse to fine.
    u_bg : ndarray, shape (2, height, width)
    v_edges : dict of ndarray, shape (2, n)
        ``v`` on the edges of known motion.
    x, motion : ndarray, shape (2, M)
        Bubbles and their motion less that of the background.
    dead : ndarray, shape (height, width)
        1 where there is no data, else 0.
    progress : bool
    weights : list of float
        Values of alpha that were chosen.
    found : Estimate, optional
        The result on the finest grid.
    """

    settings: Estimation
    grids: list[Grid]
    u_bg: Array
    v_edges: dict[Edge, Array]
    x: Array
    motion: Array
    dead: Array
    progress: bool
    weights: list[float] = field(default_factory=list)
    found: Estimate | None = None

    @property
    def alpha(self) -> float | None:
        """The weight that the scales tried so far ask for."""
        if not self.weights:
            return None
        *coarse, fine = self.weights
        return float(np.sqrt(fine * max([fine, *coarse])))

    def improve(self, grid: Grid, I1: Array, I2: Array, u: Array) -> Array:
        """A better displacement than ``u`` for the images on a grid."""
        settings, finest = self.settings, grid is self.grids[-1]
        u_bg = resize_field(self.u_bg, grid.shape)
        live = resize(self.dead, grid.shape) < 0.5
        pair = ImagePair(grid, I1, I2, live, settings.gradients == "mean")
        edges = _on_edges(grid, self.v_edges)
        known = []
        if self.x.size and (settings.speckle_scales == "all" or not finest):
            beta = _weights(grid, self.x, self.v_edges, settings)
            known.append(speckle_term(grid, self.x, self.motion, beta, settings.sigma))
        if settings.edge_weight:
            known.append(edge_term(grid, edges, settings.edge_weight))
            edges = {}
        prescribed, free = _prescribed(grid, edges)
        tried = any(grid is fine for fine in self.grids[-2:]) and enough(grid.shape)
        # The first field of a scale may still be far from it, and its residual no noise.
        near = min(1, settings.warps - 1)
        for warp in range(settings.warps):
            match = pair.linearise(u)
            if warp >= near:
                match = match.filtered(settings.denoising)
            alpha = settings.alpha or self.alpha or first_alpha(match)
            if settings.alpha is None and tried and warp == near:
                chosen = choose_alpha(match, u_bg, prescribed, free, alpha)
                self.weights.append(chosen)
                alpha = self.alpha or chosen
            terms = sum(known, start=match.density(u_bg))
            F = Quadratic(grid, terms, alpha, free, settings.smoothness).shifted(prescribed)
            about = u_bg + prescribed
            last = finest and warp == settings.warps - 1
            with solving(grid, self.progress) as report:
                change = FINE if last else ROUGH
                u = about + multigrid(F, change=change, initial=u - about, report=report)
        if finest:
            h = np.reshape(grid.spacing, (2, 1, 1))
            self.found = Estimate(u / h, alpha, pair, settings.denoising, F)
        return u


def normalised(
    I1: Array, I2: Array, settings: Estimation, spacing: tuple[float, float]
) -> tuple[Array, Array]:
    """The images as the estimate sees them; ``spacing`` is that of unit pixels."""
    if settings.local_window is None:
        return normalise(I1, I2, settings.limits)
    h1, h2 = spacing
    window = settings.local_window / h1, settings.local_window / h2
    I1, I2 = normalise(I1, I2)
    return normalise_locally(I1, window), normalise_locally(I2, window)


def _arrays(table: "pd.DataFrame | None", shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Centres and motions of a table of bubbles, shape (2, M) each, px; none give M = 0.

    Raises
    ------
    InputError
        If a bubble lies outside of an image of a ``shape``, or moves farther than its size.
    """
    if table is None:
        return np.empty((2, 0)), np.empty((2, 0))
    x, motion = np.split(table[["x1", "x2", "u1", "u2"]].to_numpy(dtype=float).T, 2)
    size = np.reshape(shape[::-1], (2, 1))
    bad = np.flatnonzero(~inside((shape[0], shape[1]), x) | (np.abs(motion) >= size).any(0))
    if bad.size:
        raise InputError(
            f"bubble {bad[0] + 1} of {x.shape[1]} lies or moves outside of the image of"
            f" {shape[0]} x {shape[1]} px; was the table made for another image?"
        )
    return x, motion


def _prescribed(grid: Grid, edges: dict[Edge, Array]) -> tuple[Array, NDArray[np.bool_]]:
    """A field that is ``v`` on the edges where it is prescribed, and the other pixels."""
    p, free = np.zeros((2, *grid.shape)), np.ones(grid.shape, dtype=bool)
    for edge, v in edges.items():
        p[:, *FACES[edge].pixels()] = v
        free[FACES[edge].pixels()] = False
    return p, free


def _on_edges(grid: Grid, edges: dict[Edge, Array]) -> dict[Edge, Array]:
    """Profiles along edges sampled on a grid, in the order in which they own corners."""
    sampled = {}
    for edge, face in FACES.items():
        if edge in edges:
            part = np.linspace(0, 1, face.along(grid.shape))
            sampled[edge] = along_edge(edges[edge], part)
    return sampled


def _weights(
    grid: Grid, x: Array, known: dict[Edge, Array], settings: Estimation
) -> NDArray[np.float64]:
    """The weights beta_i, raised near edges whose motion is not known."""
    near = [
        face.distance(x, grid) < 2 * settings.sigma
        for edge, face in FACES.items()
        if edge not in known
    ]
    factor = np.where(np.any(near, axis=0), settings.edge_bubbles, 1.0) if near else 1.0
    return settings.beta * np.broadcast_to(factor, x.shape[1:])
