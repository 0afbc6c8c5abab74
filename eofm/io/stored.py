"""Arrays that stay in their files, of which windows are read and written.

A volume may be larger than the memory. Parts of it can be read alone from a TIFF or NumPy file
whose values lie there one after the other, and from Zarr. Arrays of our own are NumPy files. They
are read and written, not mapped: pages of a map count as memory of the process.
"""

import math
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.grid import Array
from eofm.io import omezarr, plain, tiff
from eofm.io.apart import installed
from eofm.io.formats import check_is_file, one_line, split
from eofm.io.images import amplitude, check_finite, one_image
from eofm.io.origin import check_not_read
from eofm.io.places import replacing
from eofm.io.scan import Scan, choose, micrometres

Window = tuple[slice, ...]


@dataclass(frozen=True)
class Stored:
    """An image or a volume in a file.

    Attributes
    ----------
    name : str
    scan : Scan
        Its shape, axes and sizes; the values take no memory and are none.
    fetch : callable
        Reads the values of a window as they are stored.
    """

    name: str
    scan: Scan
    fetch: Callable[[Window], NDArray]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape (height, width) or (depth, height, width)."""
        return self.scan.values.shape

    def read(self, window: Window) -> Array:
        """Values of a window, as `read_scan` gives them.

        Raises
        ------
        InputError
            If they cannot be read, or are not finite.
        """
        try:
            values = self.fetch(window)
        except Exception as error:  # libraries raise whatever the damage leads to
            raise InputError(f"{self.name}: cannot be read ({one_line(error)})") from None
        return check_finite(Path(self.name), amplitude(Path(self.name), values), values.ndim)


def open_stored(path: Path) -> Stored:
    """An image or a volume of which parts can be read alone.

    Raises
    ------
    InputError
        If there is none, or none of which parts can be read.
    """
    name, parts = split(str(path))
    part, lower = "#".join(parts), name.rstrip("/").lower()
    try:
        if lower.endswith(".zarr"):
            scan, fetch = _zarr(name, part)
        else:
            check_is_file(name, "a volume")
            if part:
                raise InputError(f"{path}: of a page no part can be read alone; leave out #{part}")
            if lower.endswith(".npy"):
                scan, fetch = _raw(name, *plain.locate(name), "")
            elif lower.endswith((".tif", ".tiff")):
                scan, fetch = _raw(name, *tiff.locate(name))
            else:
                raise InputError(
                    f"{name}: only of Zarr, NumPy (.npy) and uncompressed TIFF can parts be read"
                    " alone, which tiles want; convert it"
                )
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{name}: cannot be read ({one_line(error)})") from None
    image = one_image(path, scan)
    stored = scan.values.shape
    flat = [n == 1 and axis < len(stored) - 2 for axis, n in enumerate(stored)]

    def fetch_part(window: Window) -> NDArray:
        wanted = iter(window)
        whole = tuple(slice(0, 1) if alone else next(wanted) for alone in flat)
        return fetch(whole).reshape([w.stop - w.start for w in window])

    return Stored(name, image, fetch_part)


def _raw(
    name: str,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    offsets: Sequence[int],
    axes: str,
    sizes: dict[str, float] | None = None,
) -> tuple[Scan, Callable[[Window], NDArray]]:
    """An array whose pages begin at some bytes."""

    def fetch(window: Window) -> NDArray:
        with open(name, "rb") as file:
            return _read_pages(file, dtype, shape, offsets, window)

    hollow = np.broadcast_to(np.zeros((), dtype.newbyteorder("=")), shape)
    axes = axes or "Q" * (len(shape) - 2) + "YX"
    return Scan(hollow, axes, sizes or {}), fetch


def _zarr(name: str, part: str) -> tuple[Scan, Callable[[Window], NDArray]]:
    if not installed("zarr"):
        raise InputError(f"{name}: wants another package; pip install 'eofm[zarr]'")
    names, data, axes, sizes = omezarr.find(name, part)
    if data is None:
        raise InputError(f"{name}: there is no {choose(name, names, part)}")
    hollow = np.broadcast_to(np.zeros((), data.dtype), data.shape)
    stated = {a: micrometres({a: side}, unit).get(a) for a, (side, unit) in sizes.items()}
    scan = Scan(hollow, axes, {axis: side for axis, side in stated.items() if side})
    return scan, lambda window: np.asarray(data[window])


def _read_pages(
    file: IO[bytes],
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    offsets: Sequence[int],
    window: Window,
) -> NDArray:
    *leading, rows, columns = window
    found = np.empty([w.stop - w.start for w in window], dtype.newbyteorder("="))
    width = shape[-1]
    for place in product(*(range(w.start, w.stop) for w in leading)):
        page = int(np.ravel_multi_index(place, shape[:-2])) if leading else 0
        file.seek(offsets[page] + rows.start * width * dtype.itemsize)
        lines = np.fromfile(file, dtype, (rows.stop - rows.start) * width)
        at = tuple(i - w.start for i, w in zip(place, leading, strict=True))
        found[at] = lines.reshape(-1, width)[:, columns]
    return found


class Store:
    """An array of ours in a NumPy file that is open."""

    def __init__(self, file: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.file, self.shape, self.dtype = file, shape, dtype
        self.offset = file.tell()

    @classmethod
    def of(cls, file: IO[bytes], name: str) -> "Store":
        """That of a file that is there."""
        dtype, shape, offsets = plain.locate(name)
        file.seek(offsets[0])
        return cls(file, shape, dtype)

    def read(self, window: Window) -> NDArray:
        """Values of a window."""
        self.file.flush()
        page = math.prod(self.shape[-2:]) * self.dtype.itemsize
        count = math.prod(self.shape[:-2])
        offsets = range(self.offset, self.offset + max(count * page, 1), max(page, 1))
        return _read_pages(self.file, self.dtype, self.shape, offsets, window)

    def write(self, window: Window, values: NDArray) -> None:
        """Write values to a window."""
        values = np.ascontiguousarray(values, self.dtype)
        *leading, last = window
        *_, width = self.shape
        if (last.start, last.stop) == (0, width) and leading:  # rows follow each other
            *leading, rows = leading
            first, values = rows.start * width, values.reshape(*values.shape[:-2], -1)
            stride = math.prod(self.shape[-2:])
        else:
            first, stride = last.start, width
        outer = self.shape[: len(leading)]
        for place in product(*(range(w.start, w.stop) for w in leading)):
            line = int(np.ravel_multi_index(place, outer)) if leading else 0
            at = tuple(i - w.start for i, w in zip(place, leading, strict=True))
            self.file.seek(self.offset + (line * stride + first) * self.dtype.itemsize)
            self.file.write(values[at].data)


@contextmanager
def new_store(path: Path, shape: tuple[int, ...], dtype: Any = np.float32) -> Iterator[Store]:
    """An array of zeros in a new file, which takes its place once it is complete."""
    check_not_read(path)
    with replacing(path) as temporary, temporary.open("w+b") as file:
        head = {"descr": np.lib.format.dtype_to_descr(np.dtype(dtype)), "fortran_order": False}
        np.lib.format.write_array_header_1_0(file, head | {"shape": shape})
        store = Store(file, shape, np.dtype(dtype))
        os.truncate(file.fileno(), store.offset + math.prod(shape) * store.dtype.itemsize)
        yield store


@contextmanager
def scratch_store(folder: Path, shape: tuple[int, ...]) -> Iterator[Store]:
    """An array of zeros on the disk of a folder, without a name, that goes with the process."""
    with tempfile.TemporaryFile(dir=folder) as file:
        file.truncate(4 * math.prod(shape))
        yield Store(file, shape, np.dtype(np.float32))


@contextmanager
def open_store(path: Path) -> Iterator[Store]:
    """An array of ours to read from.

    Raises
    ------
    InputError
        If there is none.
    """
    check_is_file(str(path), "an array")
    try:
        with path.open("rb") as file:
            store = Store.of(file, str(path))
            yield store
    except ValueError as error:
        raise InputError(f"{path}: cannot be read ({one_line(error)})") from None


def windows(shape: tuple[int, ...], most: int) -> Iterator[Window]:
    """Windows that make up an array, of at most so many values each: cubes, or less at the ends."""
    side = max(1, int(most ** (1 / len(shape)) + 1e-9))
    parts = [[slice(k, min(k + side, n)) for k in range(0, n, side)] for n in shape]
    yield from product(*parts)
