"""The array of a file of any format, or the variable and page of it that is named."""

import io
import os
import struct
import zipfile
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.io.limits import PATIENCE, check_size, largest
from eofm.io.origin import reading
from eofm.io.tiff import read_tiff

HDF5 = b"\x89HDF\r\n\x1a\n"
# An HDF5 file may begin with something else; MATLAB's do, with this many bytes.
MATLAB_HEAD = 512
# Names of variables that a message lists, and letters of each: MATLAB allows for so many.
MOST, LONGEST = 20, 63
# Bytes that hold the header of a NumPy file.
LONGEST_HEAD = 1 << 16
# Readers of headers by the version of the format; the third is for fields with letters.
HEADERS = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}


def read_array(path: Path) -> NDArray:
    """The array of a file, or the variable and page of it named after ``#``.

    Raises
    ------
    InputError
        If the file is missing, damaged, too large, or does not hold what is named.
    """
    name, parts = str(path), []
    if not os.path.exists(name):  # which is quiet about names that no file can have
        folder, _, last = name.rpartition("/")
        last, *parts = last.split("#")
        name = f"{folder}/{last}" if "/" in name else last
    kind = Path(name).suffix.lower()
    label = kind[1:].upper() if kind in READERS else "TIFF"
    check_is_file(name, label)
    pages = [part for part in parts if part.isdecimal()]
    variables = [part for part in parts if not part.isdecimal()]
    if len(pages) > 1 or len(variables) > (kind in (".mat", ".npz")) or (pages and kind == ".png"):
        raise InputError(f"{path}: cannot tell what #{'#'.join(parts)} means for such a file")
    try:
        with reading(Path(name)):
            array = READERS.get(kind, _read_tiff)(name, "".join(variables))
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{name}: there is not enough memory to read it") from None
    except Exception as error:  # readers raise whatever the damage leads to
        raise InputError(f"{name}: cannot be read as {label} ({one_line(error)})") from None
    if not pages:
        return array
    page = int(pages[0])
    if array.ndim < 3 or page >= len(array):
        raise InputError(f"{path}: has no page {page}; the file holds shape {array.shape}")
    return array[page]


def check_is_file(name: str, label: str) -> None:
    """Refuse what is not there, and what is no file: devices may never end."""
    if not os.path.exists(name):
        raise InputError(f"{name}: no such file")
    if not os.path.isfile(name):
        raise InputError(f"{name}: cannot be read as {label}; it is no regular file")


def one_line(error: BaseException) -> str:
    """What an error says, in one line of moderate length."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 200 else text[:200] + "..."


def _read_tiff(name: str, part: str) -> NDArray:
    return read_tiff(name)


def _read_png(name: str, part: str) -> NDArray:
    from PIL import Image

    with open(name, "rb") as file:
        head = file.read(24)
        if head[12:16] != b"IHDR" or len(head) < 24:
            raise ValueError("no PNG file")
        check_size(name, struct.unpack(">II", head[16:24]))
        check_size(name, [os.fstat(file.fileno()).st_size], 1)
        # Of a file it would make room for as much as a damaged length asks for.
        image = Image.open(io.BytesIO(head + file.read()), formats=["PNG"])
        return np.asarray(image.convert("RGB") if image.mode == "P" else image)


def _read_numpy(name: str, part: str) -> NDArray:
    with open(name, "rb") as file:
        if not zipfile.is_zipfile(file):
            return _read_npy(file, name, os.fstat(file.fileno()).st_size)
        with zipfile.ZipFile(file) as archive:
            members = {i.filename.removesuffix(".npy"): i for i in archive.infolist()}
            chosen = members[_choose(name, sorted(members), part)]
            with archive.open(chosen) as member:
                return _read_npy(member, name, chosen.file_size)


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


def _read_matlab(name: str, part: str) -> NDArray:
    """MATLAB 5 by our own reader; MATLAB 7.3 is HDF5, whose axes are the other way round."""
    with open(name, "rb") as file:
        head = file.read(MATLAB_HEAD + len(HDF5))
        if HDF5 in (head[: len(HDF5)], head[MATLAB_HEAD:]):
            from eofm.io.hdf5 import read_hdf5

            names, array = read_hdf5(os.path.abspath(name), part, largest(), PATIENCE)
            array = array if array is not None else np.empty(0)
            _choose(name, names, part)
        else:
            from eofm.io.matlab import values, variables

            check_size(name, [os.fstat(file.fileno()).st_size], 1)
            found = variables(head + file.read())
            numeric = [key for key, variable in found.items() if variable.numeric]
            chosen = part if part in found else _choose(name, numeric, part)
            array = values(found[chosen], f"{name}#{chosen[:LONGEST]}")
    # MATLAB keeps pages last.
    return np.moveaxis(array, -1, 0) if array.ndim == 3 else array


def _choose(name: str, names: list[str], part: str) -> str:
    """The variable that is named, or the only one."""
    if part in names:
        return part
    if len(names) == 1 and not part:
        return names[0]
    shown = [each[:LONGEST] for each in names[:MOST]] + ["..."] * (len(names) > MOST)
    raise InputError(
        f"{name}: name a variable, as in {name}#{next(iter(shown), 'I')}; it holds"
        f" {', '.join(shown) or 'none'}"
    )


READERS = {".png": _read_png, ".npy": _read_numpy, ".npz": _read_numpy, ".mat": _read_matlab}
