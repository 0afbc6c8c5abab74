"""The elastographic optical flow method: all five tests of the paper, and your images."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eofm.config import Edge, Estimation
from eofm.errors import InputError
from eofm.functional import Grid, Pointwise, Quadratic, data_term, speckle_term
from eofm.images import evaluate_field, gradient, normalise, resize_field, warp
from eofm.multiscale import coarse_to_fine
from eofm.solver import direct

Array = NDArray[np.float64]

EDGES: dict[Edge, tuple[int | slice, int | slice]] = {
    "top": np.s_[0, :],
    "bottom": np.s_[-1, :],
    "left": np.s_[:, 0],
    "right": np.s_[:, -1],
}


def estimate_displacement(
    I1: Array,
    I2: Array,
    settings: Estimation = Estimation(),
    *,
    bubbles: pd.DataFrame | None = None,
    background: Array | None = None,
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
        each other or the background.

    Notes
    -----
    On each scale, ``v`` minimises F, eq. (def_F), with I2 linearised about the current
    field ``u0`` (zero to start with) by ``I_t = I2(x + u0) - I1 - grad I1 . u0``. With one
    scale and one warp this is the paper's problem, ``I_t = I2 - I1``. Pixels that leave
    the image, ``x + u0(x)`` outside of it, carry no data.
    """
    u_bg = np.zeros((2, *I1.shape)) if background is None else background
    if I1.shape != I2.shape or u_bg.shape != (2, *I1.shape):
        raise InputError(
            f"images of shapes {I1.shape} and {I2.shape} and a background of {u_bg.shape[1:]}"
            " differ in size; crop or resample them to one"
        )
    x, motion = _bubble_arrays(bubbles)
    motion = motion - evaluate_field(u_bg, x)

    def improve(grid: Grid, I1: Array, I2: Array, u: Array) -> Array:
        background = resize_field(u_bg, grid.shape)
        free = free_pixels(grid.shape, settings.zero_edges)
        grad_I = gradient(I1, grid.spacing)
        speckle = speckle_term(grid, x, motion, settings.beta, settings.sigma)
        for _ in range(settings.warps):
            terms = speckle + _linearised(grid, I1, I2, grad_I, u, background)
            u = background + direct(Quadratic(grid, terms, settings.alpha, free))
        return u

    I1, I2 = normalise(I1, I2, settings.limits)
    scales, factor = settings.scales, settings.factor
    return coarse_to_fine(I1, I2, improve, scales=scales, factor=factor, progress=progress)


def free_pixels(shape: tuple[int, int], zero_edges: tuple[Edge, ...]) -> NDArray[np.bool_]:
    """Where v is sought: everywhere but on the edges with v = 0."""
    free = np.ones(shape, dtype=bool)
    for edge in zero_edges:
        free[EDGES[edge]] = False
    return free


def _linearised(
    grid: Grid, I1: Array, I2: Array, grad_I: Array, u: Array, background: Array
) -> Pointwise:
    """Data term of ``u_bg + v`` for images linearised about ``u``."""
    warped, inside = warp(I2, u / np.reshape(grid.spacing, (2, 1, 1)))
    I_t = warped - I1 - (grad_I * u).sum(0)
    return data_term(grad_I, I_t + (grad_I * background).sum(0), inside)


def _bubble_arrays(bubbles: pd.DataFrame | None) -> tuple[Array, Array]:
    if bubbles is None:
        return np.empty((2, 0)), np.empty((2, 0))
    columns = bubbles[["x1", "x2", "u1", "u2"]].to_numpy(dtype=float).T
    return columns[:2], columns[2:]
