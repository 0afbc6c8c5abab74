"""What is known of the edges of an image, from words such as ``moved 0 -30 um``."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eofm.errors import InputError
from eofm.grid import FACES, Array, Edge, Face
from eofm.io import read_columns
from eofm.settings import EDGE_WORDS


@dataclass(frozen=True)
class EdgeState:
    """An edge of the image or, where that lies outside, of the sample.

    Attributes
    ----------
    outside : bool
        The sample goes on beyond the image: no condition on the estimate.
    motion : ndarray, shape (2, n) or (3, 1, 1), or None
        Displacement along the edge, px; n = 1 where it is constant. A component is NaN, or all is
        None, where it is free.
    """

    outside: bool
    motion: Array | None


@dataclass(frozen=True)
class Place:
    """Where a region of interest lies in the whole sample, px, lateral first.

    Attributes
    ----------
    offset, size, whole : (lateral, axial) or (lateral, axial, elevational)
        First pixel and size of the region; size of the sample.
    """

    offset: tuple[int, ...]
    size: tuple[int, ...]
    whole: tuple[int, ...]

    @classmethod
    def of(cls, roi: tuple[int, ...], extent: tuple[int, ...]) -> "Place":
        """Return it for a region and a sample that are given in px of one image or volume."""
        n = len(roi) // 2
        offset = tuple(a - b for a, b in zip(roi[:n], extent[:n], strict=True))
        return cls(offset, tuple(roi[n:]), tuple(extent[n:]))

    @property
    def window(self) -> tuple[slice, ...]:
        """Index of the region in an array of the whole sample."""
        parts = zip(self.offset[::-1], self.size[::-1], strict=True)
        return tuple(slice(first, first + n) for first, n in parts)

    def inside_of(self, face: Face) -> bool:
        """Whether the sample goes on beyond an edge of the region."""
        c = face.component
        before, after = self.offset[c], self.whole[c] - self.offset[c] - self.size[c]
        return (after if face.last else before) > 0

    def part(self, face: Face, motion: Array) -> Array:
        """Motion of the region's part of an edge; n = 1 is constant."""
        if motion[0].size == 1:
            return motion
        along = 1 - face.component
        return motion[:, self.offset[along] : self.offset[along] + self.size[along]]


def parse_edge(
    edge: Edge, text: str, shape: tuple[int, ...], pixel_size: tuple[float, ...] | None
) -> EdgeState:
    """Read the description of an edge of a sample of a ``shape``, px; of a volume, of a face.

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
        return EdgeState(outside, np.zeros((len(shape), *[1] * (len(shape) - 1))))
    motion = _motion(edge, words[1:], FACES[edge].sides(shape), pixel_size)
    for i, size in enumerate(shape[::-1]):
        if abs(motion[i]).max() >= size:
            raise InputError(
                f"{edge}: moves by {abs(motion[i]).max():g} px but the image is only {size} px"
                " long in that direction; check the unit (px, or um)"
            )
    return EdgeState(outside, motion)


def _motion(
    edge: Edge, words: list[str], sides: tuple[int, ...], pixel_size: tuple[float, ...] | None
) -> Array:
    """Motion of an edge with so many pixels along its sides, px."""
    n, text = len(sides) + 1, " ".join(words)
    if len(words) == 1 and _component(words[0]) is None:
        return _profile(edge, words[0], sides)
    unit = words.pop() if words and words[-1] in ("px", "um") else "px"
    told = [_component(word) for word in words]
    if len(told) != n or None in told or np.isnan(np.array(told, dtype=float)).all():
        names = " ".join(("U1", "U2", "U3")[:n])
        raise InputError(
            f"{edge}: cannot read 'moved {text}'; say moved {names} [um], a number for each"
            f" direction of {'an image' if n == 2 else 'a volume'}, or free for some"
        )
    motion = np.reshape(np.array(told, dtype=float), (n, *[1] * (n - 1)))
    if unit == "px":
        return motion
    if pixel_size is None:
        raise InputError(
            f"{edge}: moves in um, but the size of a pixel is not known; give lateral_size and"
            " axial_size, or the motion in px"
        )
    return motion / np.reshape(pixel_size, motion.shape)


def _component(word: str) -> float | None:
    """A finite number, or NaN for what is free; None if it is neither."""
    if word == "free":
        return np.nan
    try:
        value = float(word)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _profile(edge: Edge, name: str, sides: tuple[int, ...]) -> Array:
    if len(sides) > 1:
        raise InputError(
            f"{edge}: a table of motions is of an image's edge; of a volume's face say U1 U2 U3"
        )
    motion = read_columns(Path(name), ("u1", "u2")).to_numpy(dtype=float).T
    if motion.shape[1] != sides[0]:
        raise InputError(
            f"{edge}: {name} has {motion.shape[1]} rows but the edge has {sides[0]} pixels;"
            " give one row per pixel of the sample's edge"
        )
    return motion
