"""MetaImage (.mha) and NRRD files: lines of text, then the values.

Both are read here rather than by a library, for they are simple, the libraries for MetaImage are
large, and so every length is checked. Values in another file than the header's are refused.

The formats: "MetaIO" of the ITK documentation; "Definition of NRRD File Format", Teem.
"""

import math
import os
import re
import zlib
from typing import IO

import numpy as np

from eofm.errors import InputError
from eofm.io.limits import check_size
from eofm.io.scan import Scan, micrometres

# Types of values.
META = {"CHAR": "i1", "UCHAR": "u1", "SHORT": "i2", "USHORT": "u2", "INT": "i4", "UINT": "u4"}
META |= {"LONG_LONG": "i8", "ULONG_LONG": "u8", "FLOAT": "f4", "DOUBLE": "f8"}
NRRD = {"float": "f4", "double": "f8"}
for _bits, _names in {
    8: ("int8", "signed char"),
    16: ("int16", "short", "short int", "signed short", "signed short int"),
    32: ("int32", "int", "signed int"),
    64: ("int64", "longlong", "long long", "long long int", "signed long long"),
}.items():
    _unsigned = [f"u{_names[0]}", *(f"unsigned {n.removeprefix('signed ')}" for n in _names[1:])]
    NRRD |= dict.fromkeys(_names, f"i{_bits // 8}") | dict.fromkeys(_unsigned, f"u{_bits // 8}")
NRRD |= {"uchar": "u1", "ushort": "u2", "uint": "u4", "ulonglong": "u8"}
# Longest header.
MOST = 1 << 16


def read_mha(name: str, part: str) -> Scan:
    """Read a MetaImage whose values follow its header."""
    with open(name, "rb") as file:
        said = _lines(file, "=", "ElementDataFile")
        if said["ElementDataFile"] != "LOCAL":
            raise InputError(f"{name}: its values are in another file; save them in one, as .mha")
        shape = _numbers(said["DimSize"])[::-1]
        channels = int(said.get("ElementNumberOfChannels", "1"))
        order = said.get("BinaryDataByteOrderMSB", said.get("ElementByteOrderMSB", "False"))
        kind = META.get(said["ElementType"].removeprefix("MET_"))
        if kind is None or said.get("BinaryData", "True").lower() != "true":
            raise ValueError(f"values of the type {said['ElementType']} are not known here")
        packed = said.get("CompressedData", "False").lower() == "true"
        shape = (*shape, channels) if channels > 1 else shape
        stored = np.dtype((">" if order.lower() == "true" else "<") + kind)
        values = _values(name, file, shape, stored, zlib.MAX_WBITS if packed else 0)
    axes = ("QQTZYX"[-len(shape) + (channels > 1) :]) + "S" * (channels > 1)
    spacing = said.get("ElementSpacing", said.get("ElementSize", ""))
    return Scan(values, axes, _sides(_numbers(spacing, float), said.get("DistanceUnits", "mm")))


def read_nrrd(name: str, part: str) -> Scan:
    """Read a NRRD whose values follow its header."""
    with open(name, "rb") as file:
        if file.readline(16)[:7] != b"NRRD000":
            raise ValueError("no NRRD file")
        said = {key.lower(): value for key, value in _lines(file, ":", "").items()}
        if {"data file", "datafile"} & said.keys():
            raise InputError(f"{name}: its values are in another file; save them in one, as .nrrd")
        shape = _numbers(said["sizes"])[::-1]
        kind = NRRD.get(said["type"].lower())
        packed = {"raw": 0, "gzip": zlib.MAX_WBITS + 16, "gz": zlib.MAX_WBITS + 16}
        if kind is None or said["encoding"].lower() not in packed:
            raise ValueError(f"{said['type']} values as {said['encoding']} are not known here")
        stored = np.dtype((">" if said.get("endian", "little").lower() == "big" else "<") + kind)
        values = _values(name, file, shape, stored, packed[said["encoding"].lower()])
    kinds = said.get("kinds", "").split() or ["domain"] * len(shape)
    if len(kinds) != len(shape):
        raise ValueError(f"{len(shape)} axes are stated, and kinds of {len(kinds)}")
    spatial, axes, sides = iter("XYZ"), "", {}
    vectors = re.findall(r"none|\([^)]*\)", said.get("space directions", ""))
    spacings: list[object] = list(said.get("spacings", "").split())
    spacings = spacings or [_length(vector) for vector in vectors]
    for axis, kind in enumerate(kinds):
        colour = axis == 0 and kind.lower().endswith("color")
        letter = "S" if colour else "T" if kind.lower() == "time" else "C"
        letter = next(spatial, "Q") if kind.lower() in ("domain", "space", "???") else letter
        axes = letter + axes
        sides[letter] = spacings[axis] if axis < len(spacings) else None
    quoted = re.findall(r'"([^"]*)"', said.get("space units", said.get("units", "")))
    unit = next((each for each in quoted if each), "mm" if "space" in said else "")
    return Scan(values, axes, _sides([sides.get(axis) for axis in "XYZ"], unit))


def _lines(file: IO[bytes], mark: str, last: str) -> dict[str, str]:
    """Keys and values of a header that ends with a key, or an empty line."""
    said: dict[str, str] = {}
    while last not in said:
        line = file.readline(MOST)
        text = line.decode("latin-1").strip()
        if not line.endswith(b"\n") or file.tell() > MOST:
            raise ValueError("its header does not end")
        if not text and not last:
            break
        key, found, value = text.partition(mark)
        if found and text[0] != "#":
            said[key.strip()] = value.strip().removeprefix("=").strip()
    return said


def _values(
    name: str, file: IO[bytes], shape: tuple[int, ...], stored: np.dtype, packed: int
) -> np.ndarray:
    """The values that follow, inflated by the window that zlib names so, or as they are."""
    if not 2 <= len(shape) <= 6 or min(shape) < 1:
        raise ValueError(f"its sizes are {shape[::-1]}")
    check_size(name, shape, stored.itemsize)
    check_size(name, [os.fstat(file.fileno()).st_size], 1)
    size = math.prod(shape) * stored.itemsize
    data = file.read() if packed else file.read(size)
    if packed:
        data = zlib.decompressobj(packed).decompress(data, size)
    if len(data) < size:
        raise ValueError(f"{size} bytes are stated, {len(data)} are there")
    return np.frombuffer(data, stored).reshape(shape)


def _numbers(text: str, kind: type = int) -> tuple:
    return tuple(kind(word) for word in text.split())


def _length(vector: str) -> float:
    return math.hypot(*(float(c) for c in re.split(r"[,\s]+", vector.strip("() ")) if c != "none"))


def _sides(sides: "list | tuple", unit: str) -> dict[str, float]:
    """Sides in um; those of 1 mm all are what libraries write where nobody said anything."""
    found = micrometres(dict(zip("XYZ", sides, strict=False)), unit)
    return {} if set(found.values()) == {1000.0} else found
