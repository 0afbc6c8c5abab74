"""TIFF: read after a look at its headers, written with what it comes from and a checksum."""

import hashlib
import json
import logging
import math
import os
import re
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.io import origin
from eofm.io.limits import check_size, largest
from eofm.io.places import check_place, replacing
from eofm.io.scan import AXES, Scan, micrometres

# Its warnings about damaged files come before our own line on them.
logging.getLogger("tifffile").setLevel(logging.CRITICAL)

# Bytes of a value by its type in a tag.
SIZES = (0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8)
WIDTH, LENGTH = 256, 257
PALETTE = 3
NONE, LZW, PACKED, DEFLATE = 1, 5, 32773, (8, 32946)
COMPRESSIONS = (NONE, LZW, PACKED, *DEFLATE)
# The largest factor by which a deflated strip can grow.
DEFLATED = 1032
CHECKSUM = re.compile(r"^sha256=([0-9a-f]{64})$", re.MULTILINE)
# The first image of an OME-TIFF, and what it says of the distance of its pixels.
PIXELS = re.compile(r"<(?:\w+:)?Pixels\b[^>]*>")
PHYSICAL = re.compile(r"\bPhysicalSize([XYZ])(Unit)?\s*=\s*[\"']([^\"']*)")
# Bytes of an ImageJ file, and of the beginning of a file that say what it is.
CLASSIC, HEAD = 2**32 - 2**24, 2**20
# Numerators and denominators of a resolution, well within 32 bits.
LONGEST = 10**9


def read_tiff(name: str) -> Scan:
    """The pages of a TIFF that belong together.

    Raises
    ------
    InputError
        If it asks for too much, has a colour map, or is not what was written.
    ValueError
        If it is damaged.
    """
    with _opened(name) as (tiff, series):
        check_size(name, series.shape, series.dtype.itemsize)
        page = series.keyframe
        _check_strips(name, page)
        pages = series.asarray(maxworkers=1)
        if pages.shape != series.shape:
            raise ValueError(f"it says {series.shape} and holds {pages.shape}")
        written = CHECKSUM.search(page.description or "")
        axes, sizes = _meant(series.axes), _sizes(tiff)
    if written and written[1] != _digest(pages):
        raise InputError(
            f"{name}: is not what was written (its checksum differs); make it again, or save it"
            " from Fiji if the change is meant"
        )
    return Scan(pages, axes, sizes)


def locate(
    name: str,
) -> tuple[np.dtype[Any], tuple[int, ...], Sequence[int], str, dict[str, float]]:
    """Type and shape of the pages of a TIFF, where each begins, their axes and sizes.

    Raises
    ------
    InputError
        If their values do not lie in the file one after the other.
    ValueError
        If it is damaged.
    """
    with _opened(name) as (tiff, series):
        page = series.keyframe
        if not page.is_memmappable:
            raise InputError(
                f"{name}: is compressed or in tiles, so that no part of it can be read alone; save"
                " it uncompressed, or as Zarr"
            )
        dtype, shape = series.dtype.newbyteorder(tiff.byteorder), series.shape
        bytes_, count = math.prod(page.shape) * dtype.itemsize, math.prod(shape[:-2])
        offsets: Sequence[int] = [p.dataoffsets[0] if p else -1 for p in series.pages]
        if series.dataoffset is not None:
            first = series.dataoffset
            offsets = range(first, first + max(count, 1) * bytes_, bytes_)
        size = tiff.filehandle.size
        if len(offsets) != count or any(not 0 <= at <= size - bytes_ for at in offsets):
            raise ValueError("a part of the image lies beyond the end of the file")
        return dtype, shape, offsets, _meant(series.axes), _sizes(tiff)


@contextmanager
def _opened(name: str) -> Iterator[tuple[Any, Any]]:
    """A TIFF whose pages are there, and those of them that belong together, of grey values."""
    with open(name, "rb") as file:
        _check_pages(file)
    # Another file that this one names is none of ours.
    with tifffile.TiffFile(name, _multifile=False) as tiff:
        series = tiff.series[0]
        page = series.keyframe
        if page.photometric == PALETTE and not _grey(page.colormap):
            raise InputError(f"{name}: has a colour map; convert it to greyscale first")
        yield tiff, series


def write_tiff(
    path: str | Path,
    pages: NDArray,
    labels: list[str] | None = None,
    sides: Sequence[float] | None = None,
) -> None:
    """Write a float32 image, volume or labelled channels of one as ImageJ TIFF.

    A checksum and the origin go with them, and where they are known the sides of a pixel, um,
    lateral first, such that Fiji shows them.

    Parameters
    ----------
    pages : ndarray
        Shape ([depth,] height, width), with ``labels`` ([depth,] channels, height, width).
    """
    path = check_place(path, "TIFF")
    origin.check_not_read(path)
    pages = np.ascontiguousarray(pages, np.float32)
    metadata, resolution = _said(_digest(pages), pages.shape, labels, sides)
    with replacing(path) as temporary:
        tifffile.imwrite(temporary, pages, imagej=True, metadata=metadata, resolution=resolution)


def write_slices(
    path: str | Path,
    slices: Iterable[NDArray],
    shape: tuple[int, ...],
    labels: list[str] | None = None,
    sides: Sequence[float] | None = None,
) -> None:
    """The same file as `write_tiff` makes, of a volume of a ``shape`` that comes slice by slice.

    Parameters
    ----------
    path : str or Path
    slices : iterable of ndarray
        Of shape (height, width), with ``labels`` (channels, height, width).
    shape : tuple of int
        That of all of them, (depth, ...). Beyond 4 GB the file is a BigTIFF without what ImageJ
        asks for.
    labels : list of str, optional
        What each channel is.
    sides : sequence, optional
        Sides of a voxel, um, lateral first.
    """
    path = check_place(path, "TIFF")
    origin.check_not_read(path)
    digest = _hash(np.dtype(np.float32), shape)
    unknown = "0" * (2 * digest.digest_size)
    metadata, resolution = _said(unknown, shape, labels, sides)
    small = 4 * math.prod(shape) < CLASSIC

    def pages() -> Iterator[NDArray]:
        for values in slices:
            values = np.ascontiguousarray(values, "<f4")
            digest.update(values.data)
            yield from values.reshape(-1, *shape[-2:])

    with replacing(path) as temporary:
        more: dict[str, Any] = {"imagej": True} if small else {"bigtiff": True}
        if not small:
            more["photometric"] = "minisblack"
        tifffile.imwrite(
            temporary,
            pages(),
            shape=shape,
            dtype=np.float32,
            metadata=metadata,
            resolution=resolution,
            **more,
        )
        with temporary.open("r+b") as file:
            at = file.read(HEAD).find(unknown.encode())
            if at >= 0:
                file.seek(at)
                file.write(digest.hexdigest().encode())


def _said(
    digest: str, shape: tuple[int, ...], labels: list[str] | None, sides: Sequence[float] | None
) -> tuple[dict[str, Any], Any]:
    """What goes with pages of a shape, and their resolution."""
    metadata: dict[str, Any] = {"sha256": digest}
    ndim = len(shape) - bool(labels)
    if labels is not None:
        metadata |= {
            "axes": "ZCYX"[-len(shape) :],
            "Labels": labels * (shape[0] if ndim == 3 else 1),
        }
    elif ndim == 3:
        metadata["axes"] = "ZYX"
    if (made := origin.Origin.current()) is not None:
        metadata["Info"] = json.dumps(made.record(), indent=1)
    if sides is None:
        return metadata, None
    metadata |= {"unit": "um"} | ({"spacing": float(sides[2])} if ndim == 3 else {})
    return metadata, (_resolution(sides[0]), _resolution(sides[1]))


def _resolution(side: float) -> tuple[int, int]:
    """Pixels in a micrometre, as the fraction that a TIFF holds."""
    large = max(side, 1 / side)
    a, b = Fraction(large).limit_denominator(max(int(LONGEST / large), 1)).as_integer_ratio()
    return (b, a) if side >= 1 else (a, b)


def _meant(axes: str) -> str:
    """Axes as `Scan` names them; the file may have had pages that mean nothing."""
    axes = "".join(axis if axis in "TCZYXS" else "Q" for axis in axes)
    return axes if not axes.startswith("S") else "Q" + axes[1:]


def _sizes(tiff: Any) -> dict[str, float]:
    """Distances of pixels in um that ImageJ or OME state. Dots to the inch are for printers."""
    page = tiff.pages[0]
    if tiff.is_ome:
        image = PIXELS.search(page.description or "")
        sides = {a + u: v for a, u, v in PHYSICAL.findall(image[0] if image else "")}
        sizes: dict[str, float] = {}
        for axis in (axis for axis in AXES if axis in sides):
            sizes |= micrometres({axis: sides[axis]}, sides.get(f"{axis}Unit", "um"))
        return sizes
    if not tiff.is_imagej:
        return {}
    said = tiff.imagej_metadata or {}
    unit = said.get("unit")
    sizes = micrometres({"Z": said.get("spacing", 1.0)}, said.get("zunit", unit))
    for axis, tag in (("X", "XResolution"), ("Y", "YResolution")):
        pixels, units = page.tags[tag].value if tag in page.tags else (0, 0)
        if pixels:
            sizes |= micrometres({axis: units / pixels}, said.get(f"{axis.lower()}unit", unit))
    return sizes


def _digest(pages: NDArray) -> str:
    """SHA-256 of the values, whatever the order of their bytes, and of their shape."""
    digest = _hash(pages.dtype, pages.shape)
    digest.update(np.ascontiguousarray(pages, pages.dtype.newbyteorder("<")).data)
    return digest.hexdigest()


def _hash(dtype: np.dtype[Any], shape: tuple[int, ...]) -> Any:
    """The hash of no values of a type and shape."""
    return hashlib.sha256(repr((dtype.newbyteorder("<").str, shape)).encode())


def _grey(colours: NDArray | None) -> bool:
    return colours is not None and bool((colours == colours[:1]).all())


def _check_pages(file: IO[bytes]) -> None:
    """Follow the chain of pages: each must be one, in the file, and no chain be longer than it.

    A damaged offset otherwise leads through the file byte by byte, for minutes.
    """
    size = os.fstat(file.fileno()).st_size
    head = file.read(16)
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None or len(head) < 8:
        raise ValueError("not a TIFF file")
    big = struct.unpack(order + "H", head[2:4])[0] == 43
    number, address, tag = ("Q", "Q", "HHQ8s") if big else ("H", "I", "HHI4s")
    width = struct.calcsize(order + address)
    offset = struct.unpack(order + address, head[8:16] if big else head[4:8])[0]
    left, page = size, 0
    while offset:
        tags = _tags(file, offset, order + number, order + tag, left)
        if not {WIDTH, LENGTH} <= {code for code, *_ in tags}:
            raise ValueError(f"page {page} is said to be at byte {offset}, where there is none")
        values = sum(SIZES[kind] * count for _, kind, count in tags if kind < len(SIZES))
        left -= len(tags) * struct.calcsize(order + tag) + values
        after = file.read(width)
        if left < 0 or len(after) < width:
            raise ValueError(f"page {page} says that it holds more than the file does")
        (offset,), page = struct.unpack(order + address, after), page + 1


def _tags(
    file: IO[bytes], offset: int, number: str, tag: str, left: int
) -> list[tuple[int, int, int]]:
    """Code, type and count of the tags of a page."""
    file.seek(offset)
    head = file.read(struct.calcsize(number))
    if len(head) < struct.calcsize(number):
        raise ValueError(f"a page is said to be at byte {offset}, beyond the end")
    length = struct.unpack(number, head)[0] * struct.calcsize(tag)
    table = file.read(length) if length <= left else b""
    if len(table) < length:
        raise ValueError(f"the page at byte {offset} is cut off")
    return [(code, kind, count) for code, kind, count, _ in struct.iter_unpack(tag, table)]


def _check_strips(name: str, page: Any) -> None:
    """Refuse compression that we do not know, and small files that would fill the memory by it.

    Raises
    ------
    ValueError
        If strips are not in the file, share their bytes, or one holds more than a strip.
    """
    if page.compression not in COMPRESSIONS:
        raise InputError(f"{name}: is compressed in a way not known here; save it uncompressed")
    places = sorted(zip(page.dataoffsets, page.databytecounts, strict=False))
    if any(a + n > page.parent.filehandle.size for a, n in places):
        raise ValueError("a part of the image lies beyond the end of the file")
    if page.compression == NONE:
        return
    if any(a + n > b for (a, n), (b, _) in pairwise(places)):
        raise ValueError("two parts of the image share their bytes")
    room = math.prod(page.chunks) * page.dtype.itemsize
    for offset, count in places:
        if page.compression in DEFLATE and count * DEFLATED > largest():
            page.parent.filehandle.seek(offset)
            strip = zlib.decompressobj().decompress(page.parent.filehandle.read(count), room + 1)
            if len(strip) > room:
                raise ValueError("a part of the image holds more than it says")
