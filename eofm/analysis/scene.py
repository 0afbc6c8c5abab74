"""What is known of a pair of images: read, cut to the region of interest, and checked."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skimage.draw import polygon2mask

from eofm import io
from eofm.analysis.boundary import EdgeState, parse_edge
from eofm.elasticity.forward import deform
from eofm.errors import InputError
from eofm.grid import Array, Edge
from eofm.settings import Pair, Sample


@dataclass(frozen=True)
class Scene:
    """The images of a pair or sequence and all that is known beside them.

    Attributes
    ----------
    frames : ndarray, shape (n, height, width)
        The region of interest in all frames.
    dead : ndarray of bool, shape (height, width)
        Pixels of the first frame without data.
    edges : dict of ndarray, shape (2, m)
        Known motion of edges of the region in one step, px.
    background : ndarray, shape (2, height, width), or None
        Background field of one step, px.
    sample : Sample
        Size and materials of the whole sample.
    """

    frames: Array
    dead: NDArray[np.bool_]
    edges: dict[Edge, Array]
    background: Array | None
    sample: Sample


def prepare(pair: Pair) -> Scene:
    """Read and check all that a pair describes, before any long work.

    Raises
    ------
    InputError
        In one line that begins with the key at fault.
    """
    frames = _frames(pair)
    x1, x2, width, height = pair.roi or (0, 0, frames.shape[2], frames.shape[1])
    if x1 < 0 or x2 < 0 or x1 + width > frames.shape[2] or x2 + height > frames.shape[1]:
        raise InputError(
            f"roi: reaches from ({x1}, {x2}) to ({x1 + width}, {x2 + height}), outside of the"
            f" image of {frames.shape[2]} x {frames.shape[1]} px (lateral x axial)"
        )
    window = np.s_[x2 : x2 + height, x1 : x1 + width]
    dead = _dead(pair, frames.shape[1:])[window]
    if dead.all():
        raise InputError("mask: leaves no pixel of the region of interest")
    frames = frames[:, *window]
    # What a mask hides must not stretch the grey scale.
    frames[:, dead] = np.median(frames[:, ~dead])
    extent = _extent(pair, (x1, x2, width, height))
    texts: dict[Edge, str] = {
        "top": pair.top,
        "bottom": pair.bottom,
        "left": pair.left,
        "right": pair.right,
    }
    whole = extent[3], extent[2]
    states = {e: parse_edge(e, text, whole, pair.pixel_size) for e, text in texts.items()}
    offset = x1 - extent[0], x2 - extent[1]
    beyond: dict[Edge, bool] = {
        "left": offset[0] > 0,
        "top": offset[1] > 0,
        "right": offset[0] + width < extent[2],
        "bottom": offset[1] + height < extent[3],
    }
    edges = {}
    for edge, state in states.items():
        if state.motion is None or state.outside:
            continue
        if beyond[edge]:
            raise InputError(
                f"{edge}: the sample's extent goes on beyond it; say 'outside {texts[edge]}'"
            )
        start, length = (offset[0], width) if edge in ("top", "bottom") else (offset[1], height)
        profile = state.motion.shape[1] > 1
        edges[edge] = state.motion[:, start : start + length] if profile else state.motion
    if pair.stiffness and any(beyond[edge] or state.outside for edge, state in states.items()):
        raise InputError(
            "stiffness: wants the whole sample in the region of interest; without it, estimate"
            " the displacement alone"
        )
    sample = Sample(
        height=extent[3],
        width=extent[2],
        poisson_ratio=pair.poisson_ratio,
        plane=pair.plane,
        compression=0.0,
    )
    background = _background(pair, sample, states, offset, (height, width))
    return Scene(frames, dead, edges, background, sample)


def _frames(pair: Pair) -> Array:
    if pair.frames is not None:
        frames = io.read_stack(Path(pair.frames))
    else:
        frames = np.stack(io.read_pair(Path(pair.reference or ""), Path(pair.deformed or "")))
    if pair.intensity == "log":
        if frames.min() < 0:
            raise InputError("intensity: log of negative values; use linear")
        # The least positive value bounds what has no logarithm.
        frames = np.log(np.maximum(frames, frames[frames > 0].min(initial=np.inf)))
        if not np.isfinite(frames).all():
            raise InputError("intensity: log of an image that is zero everywhere")
    return frames


def _dead(pair: Pair, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Dead zones from an image that is not 0 there, or from the corners of a polygon."""
    if pair.mask is None:
        return np.zeros(shape, dtype=bool)
    try:
        corners = np.array([[float(c) for c in w.split(",")] for w in pair.mask.split()])
    except ValueError:
        mask = io.read_image(Path(pair.mask))
        if mask.shape != shape:
            raise InputError(
                f"mask: {pair.mask} has {mask.shape[0]} x {mask.shape[1]} px but the images have"
                f" {shape[0]} x {shape[1]}; draw it on one of them"
            ) from None
        return mask != 0
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise InputError("mask: a polygon wants at least three corners 'x1,x2 x1,x2 x1,x2'")
    return polygon2mask(shape, corners[:, ::-1])


def _extent(pair: Pair, roi: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """Where the sample is, px of the image; it holds the region of interest."""
    (e1, e2, e_width, e_height), (x1, x2, width, height) = pair.extent or roi, roi
    if e1 > x1 or e2 > x2 or e1 + e_width < x1 + width or e2 + e_height < x2 + height:
        raise InputError("extent: the sample must hold the whole region of interest")
    return e1, e2, e_width, e_height


def _background(
    pair: Pair,
    sample: Sample,
    states: dict[Edge, EdgeState],
    offset: tuple[int, int],
    shape: tuple[int, int],
) -> Array | None:
    """The background field of the region that begins at an offset in the sample."""
    if pair.background == "none":
        return None
    if pair.background != "elastic":
        return io.read_field(Path(pair.background), shape)
    motion = {edge: state.motion for edge, state in states.items() if state.motion is not None}
    if not motion:
        raise InputError(
            "background: an elastic one wants an edge that is fixed or moved; say so of one"
        )
    u = deform(sample, motion, pixel_size=pair.pixel_size)
    x1, x2 = offset
    return u[:, x2 : x2 + shape[0], x1 : x1 + shape[1]]
