"""What is known of the edges of an image, from words such as ``moved 0 -30 um``."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eofm.errors import InputError
from eofm.grid import FACES, Array, Edge, Face
from eofm.io import read_columns
from eofm.settings import EDGE_WORDS, Region


@dataclass(frozen=True)
class EdgeState:
    """An edge of the image or, where that lies outside, of the sample.

    Attributes
    ----------
    outside : bool
        The sample goes on beyond the image: no condition on the estimate.
    motion : ndarray, shape (2, n), or None
        Displacement along the edge, px; n = 1 where it is constant, None where it is free.
    """

    outside: bool
    motion: Array | None


@dataclass(frozen=True)
class Place:
    """Where a region of interest lies in the whole sample, px, lateral first.

    Attributes
    ----------
    offset, size, whole : (lateral, axial)
        First pixel and size of the region; size of the sample.
    """

    offset: tuple[int, int]
    size: tuple[int, int]
    whole: tuple[int, int]

    @classmethod
    def of(cls, roi: Region, extent: Region) -> "Place":
        """Return it for a region and a sample that are given in px of one image."""
        return cls((roi[0] - extent[0], roi[1] - extent[1]), roi[2:], extent[2:])

    def inside_of(self, face: Face) -> bool:
        """Whether the sample goes on beyond an edge of the region."""
        c = face.component
        before, after = self.offset[c], self.whole[c] - self.offset[c] - self.size[c]
        return (after if face.last else before) > 0

    def part(self, face: Face, motion: Array) -> Array:
        """Motion of the region's part of an edge; n = 1 is constant."""
        along = 1 - face.component
        if motion.shape[1] == 1:
            return motion
        return motion[:, self.offset[along] : self.offset[along] + self.size[along]]


def parse_edge(
    edge: Edge, text: str, shape: tuple[int, ...], pixel_size: tuple[float, ...] | None
) -> EdgeState:
    """Read the description of an edge of a sample of a ``shape`` (height, width), px.

    The ``pixel_size`` in um, lateral first, is None where it is not known.

    Raises
    ------
    InputError
        If a word is unknown, a number is missing, a profile has another length than the
        edge, the motion is larger than the image, or in um where no pixel size is known.
    """
    words = text.split()
    outside = words[:1] == ["outside"]
    words = words[1:] if outside else words
    kind = words[0] if words else ("free" if outside else "")
    if kind not in ("free", "fixed", "moved") or (kind != "moved" and len(words) > 1):
        raise InputError(f"{edge}: cannot read '{text}'; use {EDGE_WORDS}")
    if kind == "free":
        return EdgeState(outside, None)
    if kind == "fixed":
        return EdgeState(outside, np.zeros((2, 1)))
    motion = _motion(edge, words[1:], FACES[edge].sides(shape)[0], pixel_size)
    for i, size in enumerate(shape[::-1]):
        if abs(motion[i]).max() >= size:
            raise InputError(
                f"{edge}: moves by {abs(motion[i]).max():g} px but the image is only {size} px"
                " long in that direction; check the unit (px, or um)"
            )
    return EdgeState(outside, motion)


def _motion(
    edge: Edge, words: list[str], length: int, pixel_size: tuple[float, ...] | None
) -> Array:
    if len(words) == 1:
        motion = read_columns(Path(words[0]), ("u1", "u2")).to_numpy(dtype=float).T
        if motion.shape[1] != length:
            raise InputError(
                f"{edge}: {words[0]} has {motion.shape[1]} rows but the edge has {length} pixels;"
                " give one row per pixel of the sample's edge"
            )
        return motion
    unit = words.pop() if len(words) == 3 else "px"
    try:
        motion = np.array([[float(word)] for word in words])
    except ValueError:
        motion = np.full((2, 1), np.nan)
    if motion.shape != (2, 1) or unit not in ("px", "um") or not np.isfinite(motion).all():
        raise InputError(f"{edge}: cannot read 'moved {' '.join(words)}'; use {EDGE_WORDS}")
    if unit == "px":
        return motion
    if pixel_size is None:
        raise InputError(
            f"{edge}: moves in um, but the size of a pixel is not known; give lateral_size and"
            " axial_size, or the motion in px"
        )
    return motion / np.reshape(pixel_size, (2, 1))
