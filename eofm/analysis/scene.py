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
from eofm.imaging.intensity import advise_logarithm
from eofm.settings import Pair, Region, Sample

logger = logging.getLogger("eofm")

# Corners farther away than this, px, and samples larger than so many regions, are mistakes.
FAR = 1e6
LARGEST_EXTENT = 20
# What to do about a mask that leaves nothing.
INVERTED = "is it the wrong way round? It covers what to leave out"


@dataclass(frozen=True)
class Scene:
    """The images, or volumes, of a pair or sequence and all that is known beside them.

    Attributes
    ----------
    frames : ndarray, shape (n, height, width) or (2, depth, height, width)
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
    shape = frames.shape[1:]
    roi = region_of_interest(pair, shape)
    window = Place.of(roi, (*[0] * len(shape), *shape[::-1])).window
    dead = _dead(pair, shape)[window]
    if dead.all():
        raise InputError(f"mask: leaves no pixel of the region of interest; {INVERTED}")
    frames = frames[:, *window]
    if dead.any():
        left = frames[:, ~dead]
        if (np.ptp(left, axis=1) == 0).all():
            raise InputError(f"mask: no pixel outside of it carries data; {INVERTED}")
        # What a mask hides must not stretch the grey scale.
        frames[:, dead] = np.median(left)
    if pair.intensity == "linear":
        advise_logarithm(frames[0])
    place = Place.of(roi, _extent(pair, roi))
    sample = _sample(pair, place.whole)
    on = faces(len(shape))
    texts = {edge: getattr(pair, edge) for edge in FACES}
    for edge in texts.keys() - on.keys():
        if texts[edge] != "free":
            raise InputError(f"{edge}: is a face of volumes, but these are images; leave it out")
    states = {e: parse_edge(e, texts[e], sample.shape, sides) for e in on}
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
    alike = sides or (1.0,) * len(shape)
    background = _background(pair, sample, states, place, alike)
    known = Known(None, background, edges, dead, alike, tuple(beyond))
    return Scene(frames, known, _sample(pair, place.size), pixel_size)


def _sample(pair: Pair, size: tuple[int, ...]) -> Sample:
    """The sample, of a size in px, lateral first."""
    sides = dict(zip(("width", "height", "depth"), size, strict=False))
    material = {"poisson_ratio": pair.poisson_ratio, "plane": pair.plane}
    return Sample.parse({**sides, **material, "compression": 0.0}, "sample")


def _frames(pair: Pair) -> tuple[Array, io.PixelSize | None]:
    """The frames, and the size of their pixels."""
    files = [Path(name) for name in pair.files]
    if pair.frames is not None:
        scans = [io.read_stack(files[0])]
        frames = scans[0].values
    else:
        scans = list(io.read_scans(files[0], files[1]))
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


def region_of_interest(pair: Pair, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Region of interest in images, or volumes, of a shape."""
    whole = (*[0] * len(shape), *shape[::-1])
    roi = _region("roi", pair.roi, whole)
    first, size = np.split(np.array(roi), 2)
    if (first < 0).any() or (first + size > shape[::-1]).any():
        begin, end = (f"({', '.join(map(str, x))})" for x in (first, first + size))
        what = "image" if len(shape) == 2 else "volume"
        sides = " x ".join(map(str, shape[::-1]))
        raise InputError(
            f"roi: reaches from {begin} to {end}, outside of the {what} of {sides} px"
            " (lateral x axial)"
        )
    return roi


def _region(key: str, region: Region | None, whole: tuple[int, ...]) -> tuple[int, ...]:
    """A region with as many numbers as the whole has, which it is by default.

    Four numbers of a volume leave its slices as they are.

    Raises
    ------
    InputError
        If it is that of a volume, and they are images.
    """
    if region is None:
        return whole
    if len(region) > len(whole):
        raise InputError(f"{key}: six numbers are of a volume; wants x1, x2, width and height")
    if len(region) < len(whole):
        return *region[:2], whole[2], *region[2:], whole[5]
    return region


def _dead(pair: Pair, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Dead zones from what is not 0 there, or from the corners of a polygon in all slices."""
    if pair.mask is None:
        return np.zeros(shape, dtype=bool)
    try:
        corners = np.array([[float(c) for c in w.split(",")] for w in pair.mask.split()])
    except ValueError:
        mask = io.read_image(Path(pair.mask))
        if mask.shape not in (shape, shape[-2:]):
            theirs, ours = (" x ".join(map(str, n)) for n in (mask.shape, shape))
            raise InputError(
                f"mask: {pair.mask} has {theirs} px but the images have {ours}; draw it on one of"
                " them"
            ) from None
        return np.broadcast_to(mask != 0, shape)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise InputError("mask: a polygon wants at least three corners 'x1,x2 x1,x2 x1,x2'")
    if not (np.abs(corners) < FAR).all():
        raise InputError("mask: the corners of a polygon want to be numbers near the image")
    mask = polygon2mask(shape[-2:], corners[:, ::-1])
    if not mask.any():
        raise InputError("mask: no pixel of the image lies in the polygon")
    return np.broadcast_to(mask, shape)


def _extent(pair: Pair, roi: tuple[int, ...]) -> tuple[int, ...]:
    """Where the sample is, px of the image or volume; it holds the region of interest."""
    extent = _region("extent", pair.extent, roi)
    (begin, size), (first, wanted) = np.split(np.array(extent), 2), np.split(np.array(roi), 2)
    if (begin > first).any() or (begin + size < first + wanted).any():
        raise InputError("extent: the sample must hold the whole region of interest")
    if (size > LARGEST_EXTENT * wanted).any():
        whole, part = (" x ".join(map(str, x)) for x in (size, wanted))
        raise InputError(
            f"extent: {whole} px is more than {LARGEST_EXTENT} times the region of"
            f" interest's {part} px; check its unit"
        )
    return extent


def _background(
    pair: Pair,
    sample: Sample,
    states: dict[Edge, EdgeState],
    place: Place,
    sides: tuple[float, ...],
) -> Array | None:
    """The background field of the region of interest, of pixels of any ``sides``."""
    if pair.background == "none":
        return None
    if pair.background != "elastic":
        return io.read_field(Path(pair.background), place.size[::-1])
    motion = {edge: state.motion for edge, state in states.items() if state.motion is not None}
    if not motion:
        raise InputError(
            "background: an elastic one wants an edge that is fixed or moved; say so of one"
        )
    u = deform(sample, motion, pixel_size=sides)
    return u[:, *place.window]
