"""PNG and NumPy files."""

import io
import math
import os
import struct
import zipfile
from collections.abc import Sequence
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from eofm.io.limits import check_size
from eofm.io.scan import Scan, choose, unnamed

# Bytes that hold the header of a NumPy file.
LONGEST_HEAD = 1 << 16
# Readers of headers by the version of the format; the third is for fields with letters.
HEADERS = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}


def read_png(name: str, part: str) -> Scan:
    """Read a PNG; its resolution is for printers."""
    from PIL import Image

    with open(name, "rb") as file:
        head = file.read(24)
        if head[12:16] != b"IHDR" or len(head) < 24:
            raise ValueError("no PNG file")
        check_size(name, struct.unpack(">II", head[16:24]))
        check_size(name, [os.fstat(file.fileno()).st_size], 1)
        # Of a file it would make room for as much as a damaged length asks for.
        image = Image.open(io.BytesIO(head + file.read()), formats=["PNG"])
        values = np.asarray(image.convert("RGB") if image.mode == "P" else image)
        return Scan(values, "YX" + "S" * (values.ndim - 2))


def read_numpy(name: str, part: str) -> Scan:
    """Read the array of a NumPy file, of an archive the one that is named."""
    with open(name, "rb") as file:
        if not zipfile.is_zipfile(file):
            values = _read_npy(file, name, os.fstat(file.fileno()).st_size)
            return Scan(values, unnamed(values))
        with zipfile.ZipFile(file) as archive:
            members = {i.filename.removesuffix(".npy"): i for i in archive.infolist()}
            chosen = members[choose(name, sorted(members), part)]
            with archive.open(chosen) as member:
                values = _read_npy(member, name, chosen.file_size)
                return Scan(values, unnamed(values))


def locate(name: str) -> tuple[np.dtype[Any], tuple[int, ...], Sequence[int]]:
    """Type and shape of the array of a NumPy file, and where each of its pages begins."""
    size = os.path.getsize(name)
    with open(name, "rb") as file:
        version = np.lib.format.read_magic(file)[0]
        if version not in HEADERS:
            raise ValueError(f"NumPy's format {version} is for tables")
        shape, turned, dtype = HEADERS[version](file)
        first = file.tell()
    if dtype.hasobject or turned or len(shape) < 2 or min(shape) < 1:
        raise ValueError(f"its {dtype} values of shape {shape} do not lie in rows")
    if first + dtype.itemsize * math.prod(shape) > size:
        raise ValueError(f"shape {shape} is stated, {size} bytes are there")
    page = math.prod(shape[-2:]) * dtype.itemsize
    return dtype, shape, range(first, first + math.prod(shape) * dtype.itemsize, page)


def _read_npy(file: IO[bytes], name: str, size: int) -> NDArray:
    """An array, once its header fits what is there."""
    file.seek(0)
    # From the beginning alone: a damaged length asks for as much memory.
    head = io.BytesIO(file.read(LONGEST_HEAD))
    version = np.lib.format.read_magic(head)[0]
    if version not in HEADERS:
        raise ValueError(f"NumPy's format {version} is for tables")
    shape, _, dtype = HEADERS[version](head)
    check_size(name, shape, dtype.itemsize)
    if min(shape, default=0) < 0 or dtype.itemsize * np.prod(shape, dtype=float) > size:
        raise ValueError(f"shape {shape} is stated, {size} bytes are there")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)
