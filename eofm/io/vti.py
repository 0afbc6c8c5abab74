"""VTK's XML image data (``.vti``), which ParaView opens: fields on the grid of an image or volume.

The format: "VTK XML Formats" of the VTK documentation; the values are appended as they are.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from eofm.io import origin
from eofm.io.places import check_place, replacing

# Bytes that say how many follow.
COUNT = 8


def write_vti(
    path: str | Path,
    arrays: Mapping[str, NDArray],
    sides: Sequence[float],
    components: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """Write arrays on the pixels of one image or volume, as float32; the same ones, the same bytes.

    Lateral positions become x, axial y, elevational z. Vectors of images get a third component,
    which is 0. To be warped by, a displacement wants the unit of the ``sides``.

    Parameters
    ----------
    path : str or Path
    arrays : mapping of ndarray, shape ([n,] [depth,] height, width)
        Numbers or n numbers for each pixel, by what ParaView is to call them.
    sides : sequence
        Sides of a pixel, lateral first, as many as there are axes.
    components : mapping, optional
        What to call the n numbers of an array.

    Raises
    ------
    ValueError
        If an array has another shape than the others.
    """
    fields = {name: _numbers(values, len(sides)) for name, values in arrays.items()}
    shape, *others = [values.shape[1:] for values in fields.values()]
    if any(other != shape for other in others):
        raise ValueError(f"arrays of the shapes {shape} and {others} are on no common grid")
    parts = {name: (len(f), np.moveaxis(f, 1, 0)) for name, f in fields.items()}
    write_vti_slices(path, parts, shape, sides, components)


def write_vti_slices(
    path: str | Path,
    fields: Mapping[str, tuple[int, Iterable[NDArray]]],
    shape: tuple[int, ...],
    sides: Sequence[float],
    components: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """The same file as `write_vti` makes, of arrays that come slice by slice.

    Parameters
    ----------
    path : str or Path
    fields : mapping of (int, iterable of ndarray)
        How many numbers each pixel has, and slices of them, of shape ([n,] height, width) each, of
        an image rows of shape (n, width).
    shape : tuple of int
        That of the image or volume.
    sides, components
        As of `write_vti`.
    """
    path = check_place(path, "VTI")
    origin.check_not_read(path)
    counts = {name: count for name, (count, _) in fields.items()}
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(_head(counts, shape, sides, components or {}).encode())
        for count, parts in fields.values():
            file.write(np.array(4 * count * math.prod(shape), "<u8").tobytes())
            for part in parts:
                numbers = np.moveaxis(part.reshape(count, *shape[1:]), 0, -1)
                file.write(np.ascontiguousarray(numbers, "<f4").tobytes())
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


def _numbers(values: NDArray, ndim: int) -> NDArray:
    """The numbers of all pixels, shape (n, ...); vectors have three."""
    if values.ndim == ndim:
        return values[None]
    if values.ndim != ndim + 1:
        raise ValueError(f"an array of shape {values.shape} is on no grid with {ndim} axes")
    if len(values) == ndim == 2:
        return np.concatenate([values, np.zeros_like(values[:1])])
    return values


def _head(
    fields: Mapping[str, int],
    shape: tuple[int, ...],
    sides: Sequence[float],
    components: Mapping[str, Sequence[str]],
) -> str:
    """All that stands before the values."""
    counts, flat = [*shape[::-1], 1, 1][:3], [1.0] * (3 - len(sides))
    extent = " ".join(f"0 {n - 1}" for n in counts)
    spacing = " ".join(repr(float(side)) for side in (*sides, *flat))
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        f'<ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="{spacing}">',
    ]
    if (made := origin.Origin.current()) is not None:
        codes = " ".join(str(code) for code in json.dumps(made.record()).encode())
        kind = '<Array type="String" Name="provenance" NumberOfTuples="1" format="ascii">'
        lines += ["<FieldData>", f"{kind}{codes} 0</Array>", "</FieldData>"]
    lines += [f'<Piece Extent="{extent}">', "<PointData>"]
    offset = 0
    for name, count in fields.items():
        named = enumerate(components.get(name, ()))
        names = "".join(f" ComponentName{n}={quoteattr(word)}" for n, word in named)
        lines.append(
            f'<DataArray type="Float32" Name={quoteattr(name)}'
            f' NumberOfComponents="{count}"{names}'
            f' format="appended" offset="{offset}"/>'
        )
        offset += COUNT + 4 * count * math.prod(shape)
    lines += ["</PointData>", "</Piece>", "</ImageData>", '<AppendedData encoding="raw">', "_"]
    return "\n".join(lines)
