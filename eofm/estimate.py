"""The elastographic optical flow method: all five tests of the paper, and your images."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eofm.bubbles import as_arrays
from eofm.config import Edge, Estimation
from eofm.errors import InputError
from eofm.functional import (
    EDGES,
    Grid,
    Pointwise,
    Quadratic,
    data_term,
    edge_term,
    speckle_term,
)
from eofm.images import (
    evaluate_field,
    gradient,
    normalise,
    normalise_locally,
    resize,
    resize_field,
    unit_spacing,
    warp,
)
from eofm.multigrid import multigrid
from eofm.multiscale import coarse_to_fine, solving

Array = NDArray[np.float64]

# Relative residual of the solves; u changes by less than 1e-4 px below it.
TOLERANCE = 1e-5


def estimate_displacement(
    I1: Array,
    I2: Array,
    settings: Estimation = Estimation(),
    *,
    bubbles: pd.DataFrame | None = None,
    background: Array | None = None,
    edges: dict[Edge, Array] | None = None,
    dead: NDArray[np.bool_] | None = None,
    pixel_size: tuple[float, float] = (1.0, 1.0),
    progress: bool = False,
) -> Array:
    """Displacement between two images by elastographic optical flow.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width)
        Images before and after compression.
    settings : Estimation
        Weights, scales and edges.
    bubbles : DataFrame, optional
        Columns x1, x2, u1, u2, px, as ``track`` returns them; without it there is no
        speckle term.
    background : ndarray, shape (2, height, width), optional
        The field u_bg of eq. (Ansatz), px; without it u_bg = 0.
    edges : dict of ndarray, shape (2, n), optional
        Known motion ``g`` of the n pixels of some edges, px, eq. (bdc_Dirichlet).
    dead : ndarray of bool, shape (height, width), optional
        Pixels before compression that carry no data.
    pixel_size : (lateral, axial)
        Sides of a pixel in any unit. Where they differ, smoothness and sigma are measured
        in true lengths, in units of their geometric mean.
    progress : bool
        Show a progress bar, if standard error is a terminal.

    Returns
    -------
    ndarray, shape (2, height, width)
        ``u = u_bg + v``, px, with ``I2(x + u(x)) = I1(x)``: lateral (to the right) and
        axial (down) displacement of what was at x before compression.

    Raises
    ------
    InputError
        If the images are constant, too small for the scales, or differ in size from
        each other, the background or the dead zones, or a bubble lies outside of them.

    Notes
    -----
    On each scale, ``v`` minimises F, eq. (def_F), with I2 linearised about the current
    field ``u0`` (zero or u_bg to start with) by ``I_t = I2(x + u0) - I1 - grad I1 . u0``.
    With one scale, one warp and zero to start with this is the paper's problem,
    ``I_t = I2 - I1``. Pixels that leave the image, ``x + u0(x)`` outside of it, carry no
    data.
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
    v_edges = {edge: h * g - u_bg[:, *EDGES[edge]] for edge, g in (edges or {}).items()}
    v_edges |= {edge: np.zeros_like(u_bg[:, *EDGES[edge]]) for edge in settings.zero_edges}
    x, motion = as_arrays(bubbles, I1.shape)
    update = h * (motion - evaluate_field(background, x))
    problem = _Problem(settings, u_bg, v_edges, h * x, update, dead.astype(float), progress)
    I1, I2 = normalised(I1, I2, settings, (h1, h2))
    u = coarse_to_fine(
        I1,
        I2,
        problem.improve,
        scales=settings.scales,
        factor=settings.factor,
        spacing=(h1, h2),
        start=u_bg if settings.start == "background" else None,
        progress=progress,
    )
    return u / h[..., None]


@dataclass(frozen=True)
class _Problem:
    """All that F is made of beside the images, in true lengths.

    Attributes
    ----------
    settings : Estimation
    u_bg : ndarray, shape (2, height, width)
    v_edges : dict of ndarray, shape (2, n)
        ``v`` on the edges of known motion.
    x, motion : ndarray, shape (2, M)
        Bubbles and their motion less that of the background.
    dead : ndarray, shape (height, width)
        1 where there is no data, else 0.
    progress : bool
    """

    settings: Estimation
    u_bg: Array
    v_edges: dict[Edge, Array]
    x: Array
    motion: Array
    dead: Array
    progress: bool

    def improve(self, grid: Grid, I1: Array, I2: Array, u: Array) -> Array:
        """A better displacement than ``u`` for the images on a grid."""
        settings = self.settings
        u_bg = resize_field(self.u_bg, grid.shape)
        live = resize(self.dead, grid.shape) < 0.5
        grad_I = gradient(I1, grid.spacing)
        edges = _on_edges(grid, self.v_edges)
        beta = _weights(grid, self.x, self.v_edges, settings)
        known = speckle_term(grid, self.x, self.motion, beta, settings.sigma)
        if settings.edge_weight:
            known += edge_term(grid, edges, settings.edge_weight)
            edges = {}
        prescribed, free = _prescribed(grid, edges)
        for _ in range(settings.warps):
            terms = known + _linearised(grid, I1, I2, grad_I, u, u_bg, live)
            F = Quadratic(grid, terms, settings.alpha, free)
            with solving(grid, self.progress) as report:
                v = multigrid(
                    F.shifted(prescribed),
                    tol=TOLERANCE,
                    initial=u - u_bg - prescribed,
                    report=report,
                )
            u = u_bg + prescribed + v
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


def _prescribed(grid: Grid, edges: dict[Edge, Array]) -> tuple[Array, NDArray[np.bool_]]:
    """A field that is ``v`` on the edges where it is prescribed, and the other pixels."""
    p, free = np.zeros((2, *grid.shape)), np.ones(grid.shape, dtype=bool)
    for edge, v in edges.items():
        p[:, *EDGES[edge]] = v
        free[EDGES[edge]] = False
    return p, free


def _on_edges(grid: Grid, edges: dict[Edge, Array]) -> dict[Edge, Array]:
    """Profiles along edges sampled on a grid; top and bottom come last and own the corners."""
    order: tuple[Edge, ...] = ("left", "right", "top", "bottom")
    sampled = {}
    for edge in filter(edges.__contains__, order):
        n = grid.shape[1] if edge in ("top", "bottom") else grid.shape[0]
        at = np.linspace(0, edges[edge].shape[1] - 1, n)
        sampled[edge] = np.stack([np.interp(at, np.arange(len(c)), c) for c in edges[edge]])
    return sampled


def _weights(
    grid: Grid, x: Array, known: dict[Edge, Array], settings: Estimation
) -> NDArray[np.float64]:
    """The weights beta_i, raised near edges whose motion is not known."""
    distance = {
        "top": x[1],
        "bottom": grid.x2[-1] - x[1],
        "left": x[0],
        "right": grid.x1[-1] - x[0],
    }
    near = [d < 2 * settings.sigma for edge, d in distance.items() if edge not in known]
    factor = np.where(np.any(near, axis=0), settings.edge_bubbles, 1.0) if near else 1.0
    return settings.beta * np.broadcast_to(factor, x.shape[1:])


def _linearised(
    grid: Grid,
    I1: Array,
    I2: Array,
    grad_I: Array,
    u: Array,
    u_bg: Array,
    live: NDArray[np.bool_],
) -> Pointwise:
    """Data term of ``u_bg + v`` for images linearised about ``u``."""
    warped, inside = warp(I2, u / np.reshape(grid.spacing, (2, 1, 1)))
    I_t = warped - I1 - (grad_I * u).sum(0)
    return data_term(grad_I, I_t + (grad_I * u_bg).sum(0), inside & live)
