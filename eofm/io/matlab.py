"""MATLAB files: arrays of numbers.

Those of MATLAB 7.3 are HDF5. Of those before, SciPy's reader trusts the lengths that a file
states and may end the process with it. This one reads full arrays of numbers only, checks every
length, and so cannot.

The format: "MAT-File Format", The MathWorks, level 5.
"""

import math
import os
import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.io.apart import read_apart
from eofm.io.limits import PATIENCE, check_size, largest
from eofm.io.scan import Scan, choose, unnamed

# Types of values, and classes of arrays of numbers with what they become.
VALUES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8"}
VALUES |= {13: "u8"}
CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4"}
CLASSES |= {14: "i8", 15: "u8"}
OTHERS = {1: "a cell array", 2: "a structure", 3: "an object", 4: "text", 5: "sparse"}
INT32, UINT32, INT8, MATRIX, COMPRESSED = 5, 6, 1, 14, 15
COMPLEX, LOGICAL = 0x800, 0x200
# Header of an array: flags, sizes and name, and what is read to find them.
HEAD = 4096
HDF5 = b"\x89HDF\r\n\x1a\n"
# An HDF5 file may begin with something else; MATLAB's do, with this many bytes.
BEFORE = 512
# Letters of a name: MATLAB allows for so many.
LONGEST = 63


@dataclass(frozen=True)
class Variable:
    """An array of a file, of which the values have not been read."""

    kind: int
    flags: int
    order: str
    shape: tuple[int, ...]
    body: bytes
    start: int
    compressed: bool

    @property
    def numeric(self) -> bool:
        """Whether it is a full array of numbers."""
        return self.kind in CLASSES


def read_matlab(name: str, part: str) -> Scan:
    """Read the variable that is named, or the only one; pages come first, as everywhere here."""
    with open(name, "rb") as file:
        head = file.read(BEFORE + len(HDF5))
        if HDF5 in (head[: len(HDF5)], head[BEFORE:]):
            names, array, _, _ = read_apart("hdf5", name, part, largest(), PATIENCE)
            if array is None:
                choose(name, names, part)
                raise ValueError("it changed while it was read")
            array = array.T
        else:
            check_size(name, [os.fstat(file.fileno()).st_size], 1)
            found = variables(head + file.read())
            numeric = [key for key, variable in found.items() if variable.numeric]
            chosen = part if part in found else choose(name, numeric, part)
            array = values(found[chosen], f"{name}#{chosen[:LONGEST]}")
    array = array.transpose(*range(2, array.ndim)[::-1], 0, 1)
    return Scan(array, unnamed(array))


def variables(data: bytes) -> dict[str, Variable]:
    """The variables of a file by name.

    Raises
    ------
    ValueError
        If it is damaged or no such file.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError("no MATLAB 5 file; save it by save -v7 or -v7.3")
    found, offset = {}, 128
    while offset + 8 <= len(data):
        kind, length = struct.unpack_from(order + "II", data, offset)
        body = data[offset + 8 : offset + 8 + length]
        if len(body) < length:
            raise ValueError(f"the variable at byte {offset} is cut off")
        if kind in (MATRIX, COMPRESSED):
            name, variable = _variable(body, order, kind == COMPRESSED)
            found[name] = variable
        offset += 8 + length
    return found


def values(variable: Variable, name: str) -> NDArray:
    """The array of a variable, which messages name.

    Raises
    ------
    InputError
        If it holds something else than numbers, or asks for too much.
    ValueError
        If it is damaged.
    """
    if not variable.numeric:
        what = OTHERS.get(variable.kind, "no array")
        raise InputError(f"{name}: is {what}; save a full array of numbers")
    parts = 2 if variable.flags & COMPLEX else 1
    check_size(name, variable.shape, 8 * parts)
    count, order, body = math.prod(variable.shape), variable.order, variable.body
    if variable.compressed:
        body = _inflate(body, variable.start + parts * (8 + 8 * count + 8))
    flat, after = _numbers(body, variable.start, order, count)
    if parts > 1:
        flat = flat + 1j * _numbers(body, after, order, count)[0]
        return flat.reshape(variable.shape, order="F")
    wanted = np.dtype(bool if variable.flags & LOGICAL else CLASSES[variable.kind])
    return flat.astype(wanted).reshape(variable.shape, order="F")


def _numbers(body: bytes, start: int, order: str, count: int) -> tuple[NDArray, int]:
    """The values of an element of ``count`` numbers, and where the next one begins."""
    kind, part, after = _element(body, start, order)
    if kind not in VALUES:
        raise ValueError(f"values of the unknown type {kind}")
    stored = np.dtype(order + VALUES[kind])
    if len(part) < count * stored.itemsize:
        raise ValueError(f"{count} values are stated, {len(part) // stored.itemsize} are there")
    return np.frombuffer(part, stored, count), after


def _variable(body: bytes, order: str, compressed: bool) -> tuple[str, Variable]:
    """Name and header of a variable."""
    head, start = body, 0
    if compressed:
        head, start = _inflate(body, HEAD), 8
        if len(head) < 8 or struct.unpack_from(order + "I", head)[0] != MATRIX:
            raise ValueError("a compressed element is no array")
    kind, flags, offset = _element(head, start, order)
    if kind != UINT32 or len(flags) < 8:
        raise ValueError("an array without flags")
    (flag,) = struct.unpack_from(order + "I", flags)
    kind, sizes, offset = _element(head, offset, order)
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes[: len(sizes) // 4 * 4])
    if kind != INT32 or not 1 < len(shape) <= 32 or min(shape) < 0:
        raise ValueError("an array without sizes")
    kind, letters, offset = _element(head, offset, order)
    if kind != INT8:
        raise ValueError("an array without name")
    name = letters.decode("latin-1")
    return name, Variable(flag & 0xFF, flag, order, shape, body, offset, compressed)


def _element(data: bytes, offset: int, order: str) -> tuple[int, bytes, int]:
    """Type and bytes of an element, and where the next one begins."""
    if offset + 8 > len(data):
        raise ValueError("an array is cut off")
    kind, length = struct.unpack_from(order + "II", data, offset)
    if kind >> 16:  # a small element: its length beside its type, its bytes behind
        kind, length = kind & 0xFFFF, kind >> 16
        if length > 4:
            raise ValueError("a small element is too long")
        return kind, data[offset + 4 : offset + 4 + length], offset + 8
    part = data[offset + 8 : offset + 8 + length]
    return kind, part, offset + 8 + -(-length // 8) * 8


def _inflate(data: bytes, most: int) -> bytes:
    try:
        return zlib.decompressobj().decompress(data, most)
    except zlib.error as error:
        raise ValueError(str(error)) from None
