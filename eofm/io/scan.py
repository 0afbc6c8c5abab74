"""What a file holds: an array, the meaning of its axes, and how far apart its pixels are."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from numpy.typing import NDArray

from eofm.errors import InputError

logger = logging.getLogger("eofm")

# Array axes of the components, lateral first, and how settings call the sides of a pixel.
AXES = "XYZ"
SIZES = ("lateral_size", "axial_size", "elevational_size")
# Micrometres in a unit, as microscopes and scanners write it. Inches are left out: they come from
# printing, where 72 or 300 dots to the inch say nothing of a sample.
UNITS = dict.fromkeys(("um", "micron", "microns", "micrometer", "micrometre", "micrometers"), 1.0)
UNITS |= {"\N{MICRO SIGN}m": 1.0, "\N{GREEK SMALL LETTER MU}m": 1.0, "\\u00b5m": 1.0}
UNITS |= {"nm": 1e-3, "nanometer": 1e-3, "mm": 1e3, "millimeter": 1e3, "millimetre": 1e3}
UNITS |= {"cm": 1e4, "centimeter": 1e4, "m": 1e6, "meter": 1e6, "metre": 1e6}
# Sizes beyond these, um, are damage.
LEAST, LARGEST = 1e-6, 1e9
# Part by which two files may differ in what they state: rounding of fractions.
SAME = 1e-4
# Names of arrays that a message lists, and letters of each.
MOST, LONGEST = 20, 63


@dataclass(frozen=True)
class Scan:
    """The array of a file.

    Attributes
    ----------
    values : ndarray
    axes : str
        A letter for each of its axes: Y and X of a page, Z slices, T time, C channels, S colours
        of a pixel, Q for what the file does not say.
    sizes : mapping
        Distance of pixels along the axes X, Y and Z, um, as far as the file states it.
    """

    values: NDArray
    axes: str
    sizes: Mapping[str, float] = field(default_factory=dict)


class PixelSize(NamedTuple):
    """Sides of a pixel and where they come from.

    Attributes
    ----------
    sides : tuple of float
        Lateral, axial and, of a volume, elevational side, um.
    source : str
        Who says so.
    """

    sides: tuple[float, ...]
    source: str


def unnamed(values: NDArray) -> str:
    """Axes of an array of which the file says nothing but its shape."""
    colours = values.ndim > 2 and values.shape[-1] in (2, 3, 4)
    return "Q" * (values.ndim - 2 - colours) + "YX" + "S" * colours


def choose(name: str, names: list[str], part: str) -> str:
    """The array of a file that is named, or the only one.

    Raises
    ------
    InputError
        If there is none of that name, or it has to be named.
    """
    if part in names:
        return part
    if len(names) == 1 and not part:
        return names[0]
    shown = [each[:LONGEST] for each in names[:MOST]] + ["..."] * (len(names) > MOST)
    raise InputError(
        f"{name}: name a variable, as in {name}#{next(iter(shown), 'I')}; it holds"
        f" {', '.join(shown) or 'none'}"
    )


def micrometres(values: Mapping[str, object], unit: object) -> dict[str, float]:
    """Sizes by axis in um, without those that are no sizes, or whose unit is not known."""
    factor = UNITS.get(str(unit).strip().lower(), math.nan)
    found = {}
    for axis, value in values.items():
        try:
            size = float(value) * factor  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            continue
        if LEAST <= size <= LARGEST:
            found[axis] = size
    return found


def pixel_size(
    scans: Mapping[str, Scan], ndim: int, given: Sequence[float | None] = ()
) -> PixelSize | None:
    """Sides of the pixels of images: those that are given, or those that the files state.

    The log says what was taken from a file.

    Parameters
    ----------
    scans : mapping
        What was read, by the names of the files.
    ndim : int
        Number of axes of the images.
    given : sequence
        What the user says, lateral first; None, and what is missing, is left open.

    Returns
    -------
    PixelSize or None
        None where nobody says anything.

    Raises
    ------
    InputError
        If two files contradict each other, or one side is known and another is not.
    """
    given = [*given, None, None, None][:ndim]
    sides, sources = list(given), [SIZES[c] for c in range(ndim) if given[c] is not None]
    for c in (c for c in range(ndim) if given[c] is None):
        stated = {name: s.sizes[AXES[c]] for name, s in scans.items() if AXES[c] in s.sizes}
        if not stated:
            continue
        if max(stated.values()) > min(stated.values()) * (1 + SAME):
            said = " but ".join(f"{size:g} um in {name}" for name, size in stated.items())
            raise InputError(f"{SIZES[c]}: is {said}; say which by {SIZES[c]}, or rescale one")
        name, sides[c] = next(iter(stated.items()))
        sources += [name] if name not in sources else []
    if not sources:
        return None
    for c, side in enumerate(sides):
        if side is None:
            raise InputError(
                f"{SIZES[c]}: is not known, while another side of the pixels is (from"
                f" {', '.join(sources)}); give it too, um"
            )
    found = PixelSize(tuple(side for side in sides if side is not None), ", ".join(sources))
    if not set(sources) <= set(SIZES):
        words = " x ".join(f"{side:g}" for side in found.sides)
        logger.info(f"pixels of {words} um, from {found.source}")
    return found
