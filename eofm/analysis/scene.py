"""What is known of a pair of images: read, cut to the region of interest, and checked."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skimage.draw import polygon2mask

from eofm import io
from eofm.analysis.boundary import EdgeState, Place, parse_edge
from eofm.elasticity.forward import deform
from eofm.errors import InputError
from eofm.flow.known import Known
from eofm.grid import FACES, Array, Edge, faces
from eofm.settings import Pair, Region, Sample

logger = logging.getLogger("eofm")

# Corners farther away than this, px, and samples larger than so many regions, are mistakes.
FAR = 1e6
LARGEST_EXTENT = 20


@dataclass(frozen=True)
class Scene:
    """The images of a pair or sequence and all that is known beside them.

    Attributes
    ----------
    frames : ndarray, shape (n, height, width)
        The region of interest in all frames.
    known : Known
        Dead zones of the first frame, and edges and background of one step.
    sample : Sample
        Materials of the sample, and its size, as far as the frames show it.
    pixel_size : PixelSize or None
        Sides of a pixel, um, and who says so; None where they are not known. `known` counts them
        as equal then.
    """

    frames: Array
    known: Known
    sample: Sample
    pixel_size: io.PixelSize | None


def read_scene(pair: Pair) -> Scene:
    """Read and check all that a pair describes, before any long work.

    Parameters
    ----------
    pair : Pair
        Files, and words such as those of the command ``eofm sample``.

    Raises
    ------
    InputError
        In one line that begins with the key at fault.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import numpy as np
    >>> import eofm
    >>> before, after, _ = eofm.make_phantom(np.zeros((2, 40, 60)))
    >>> with tempfile.TemporaryDirectory() as name:
    ...     files = [pathlib.Path(name) / "before.tif", pathlib.Path(name) / "after.tif"]
    ...     for file, image in zip(files, (before, after)):
    ...         eofm.io.write_image(file, image)
    ...     pair = eofm.Pair(reference=files[0], deformed=files[1], top="fixed")
    ...     scene = eofm.read_scene(pair)
    >>> scene.frames.shape, sorted(scene.known.edges)
    ((2, 40, 60), ['top'])
    """
    frames, pixel_size = _frames(pair)
    sides = pixel_size.sides if pixel_size else None
    roi = _roi(pair, frames.shape[1:])
    window = np.s_[roi[1] : roi[1] + roi[3], roi[0] : roi[0] + roi[2]]
    dead = _dead(pair, frames.shape[1:])[window]
    if dead.all():
        raise InputError("mask: leaves no pixel of the region of interest")
    frames = frames[:, *window]
    # What a mask hides must not stretch the grey scale.
    frames[:, dead] = np.median(frames[:, ~dead])
    place = Place.of(roi, _extent(pair, roi))
    sample = Sample(
        height=place.whole[1],
        width=place.whole[0],
        poisson_ratio=pair.poisson_ratio,
        plane=pair.plane,
        compression=0.0,
    )
    texts = {edge: getattr(pair, edge) for edge in faces(2)}
    states = {e: parse_edge(e, text, sample.shape, sides) for e, text in texts.items()}
    edges: dict[Edge, Array] = {}
    beyond: list[Edge] = []
    for edge, state in states.items():
        outside = place.inside_of(FACES[edge])
        if state.motion is not None and not state.outside:
            if outside:
                raise InputError(
                    f"{edge}: the sample's extent goes on beyond it; say 'outside {texts[edge]}'"
                )
            edges[edge] = place.part(FACES[edge], state.motion)
        if outside or state.outside:
            beyond.append(edge)
    alike = sides or (1.0,) * (frames.ndim - 1)
    background = _background(pair, sample, states, place, alike)
    known = Known(None, background, edges, dead, alike, tuple(beyond))
    return Scene(frames, known, sample.changed(height=roi[3], width=roi[2]), pixel_size)


def _frames(pair: Pair) -> tuple[Array, io.PixelSize | None]:
    """The frames, and the size of their pixels."""
    files = [Path(name) for name in pair.files]
    if pair.frames is not None:
        scans = [io.read_stack(files[0])]
        frames = scans[0].values
    else:
        scans = list(io.read_scans(files[0], files[1], ndim=2))
        frames = np.stack([scan.values for scan in scans])
    named = dict(zip(pair.files, scans, strict=True))
    return _scaled(pair, frames), io.pixel_size(named, frames.ndim - 1, pair.sides)


def _scaled(pair: Pair, frames: Array) -> Array:
    """The frames, or their logarithm."""
    if pair.intensity == "log":
        if frames.min() < 0:
            raise InputError("intensity: log of negative values; use linear")
        # The least positive value bounds what has no logarithm.
        frames = np.log(np.maximum(frames, frames[frames > 0].min(initial=np.inf)))
        if not np.isfinite(frames).all():
            raise InputError("intensity: log of an image that is zero everywhere")
    return frames


def _roi(pair: Pair, shape: tuple[int, ...]) -> Region:
    """Region of interest in images of a shape."""
    height, width = shape
    roi = x1, x2, columns, rows = pair.roi or (0, 0, width, height)
    if x1 < 0 or x2 < 0 or x1 + columns > width or x2 + rows > height:
        raise InputError(
            f"roi: reaches from ({x1}, {x2}) to ({x1 + columns}, {x2 + rows}), outside of the"
            f" image of {width} x {height} px (lateral x axial)"
        )
    return roi


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
    if not (np.abs(corners) < FAR).all():
        raise InputError("mask: the corners of a polygon want to be numbers near the image")
    mask = polygon2mask(shape, corners[:, ::-1])
    if not mask.any():
        raise InputError("mask: no pixel of the image lies in the polygon")
    return mask


def _extent(pair: Pair, roi: Region) -> Region:
    """Where the sample is, px of the image; it holds the region of interest."""
    (e1, e2, e_width, e_height), (x1, x2, width, height) = pair.extent or roi, roi
    if e1 > x1 or e2 > x2 or e1 + e_width < x1 + width or e2 + e_height < x2 + height:
        raise InputError("extent: the sample must hold the whole region of interest")
    if e_width > LARGEST_EXTENT * width or e_height > LARGEST_EXTENT * height:
        raise InputError(
            f"extent: {e_width} x {e_height} px is more than {LARGEST_EXTENT} times the region of"
            f" interest's {width} x {height} px; check its unit"
        )
    return e1, e2, e_width, e_height


def _background(
    pair: Pair,
    sample: Sample,
    states: dict[Edge, EdgeState],
    place: Place,
    sides: tuple[float, ...],
) -> Array | None:
    """The background field of the region of interest, of pixels of any ``sides``."""
    (width, height), (x1, x2) = place.size, place.offset
    if pair.background == "none":
        return None
    if pair.background != "elastic":
        return io.read_field(Path(pair.background), (height, width))
    motion = {edge: state.motion for edge, state in states.items() if state.motion is not None}
    if not motion:
        raise InputError(
            "background: an elastic one wants an edge that is fixed or moved; say so of one"
        )
    u = deform(sample, motion, pixel_size=sides)
    return u[:, x2 : x2 + height, x1 : x1 + width]
