"""TIFF: read after a look at its headers, written with what it comes from and a checksum."""

import hashlib
import json
import logging
import math
import os
import re
import struct
import zlib
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


def read_tiff(name: str) -> NDArray:
    """The pages of a TIFF that belong together.

    Raises
    ------
    InputError
        If it asks for too much, has a colour map, or is not what was written.
    ValueError
        If it is damaged.
    """
    with open(name, "rb") as file:
        _check_pages(file)
    # Another file that this one names is none of ours.
    with tifffile.TiffFile(name, _multifile=False) as tiff:
        series = tiff.series[0]
        check_size(name, series.shape, series.dtype.itemsize)
        page = series.keyframe
        _check_strips(name, page)
        if page.photometric == PALETTE and not _grey(page.colormap):
            raise InputError(f"{name}: has a colour map; convert it to greyscale first")
        pages = series.asarray(maxworkers=1)
        written = CHECKSUM.search(page.description or "")
    if written and written[1] != _digest(pages):
        raise InputError(
            f"{name}: is not what was written (its checksum differs); make it again, or save it"
            " from Fiji if the change is meant"
        )
    return pages


def write_tiff(path: Path, pages: NDArray, labels: list[str] | None = None) -> None:
    """Write float32 pages as ImageJ TIFF, with labels, a checksum and their origin."""
    check_place(path, "TIFF")
    origin.check_not_read(path)
    pages = pages.astype(np.float32)
    metadata: dict[str, Any] = {"sha256": _digest(pages)}
    if labels is not None:
        metadata |= {"axes": "CYX", "Labels": labels}
    if (made := origin.Origin.current()) is not None:
        metadata["Info"] = json.dumps(made.record(), indent=1)
    with replacing(path) as temporary:
        tifffile.imwrite(temporary, pages, imagej=True, metadata=metadata)


def _digest(pages: NDArray) -> str:
    """SHA-256 of the values, whatever the order of their bytes, and of their shape."""
    said = repr((pages.dtype.newbyteorder("<").str, pages.shape)).encode()
    values = np.ascontiguousarray(pages, pages.dtype.newbyteorder("<"))
    return hashlib.sha256(said + values.tobytes()).hexdigest()


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
