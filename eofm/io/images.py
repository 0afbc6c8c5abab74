"""What a file holds, checked: an image, a stack, a pair, a field; and writing them."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.grid import Array
from eofm.io.formats import read_array
from eofm.io.tiff import write_tiff

# Smaller images hold no motion to speak of.
SMALLEST = 8


def read_image(path: Path) -> Array:
    """Read a greyscale image, shape (height, width): TIFF, PNG, NumPy or MATLAB.

    ``FILE#3`` is page 3 (from 0) of a stack, ``FILE#name`` a variable of a MATLAB or NumPy file,
    ``FILE#name#3`` a page of it.

    Raises
    ------
    InputError
        If the file is missing, unreadable, in colour, a stack, or has NaN or infinity.
    """
    pages = read_array(path)
    if pages.ndim == 3 and pages.shape[-1] in (3, 4):
        pages = _grey(path, pages)
    if pages.ndim == 3 and pages.shape[-1] == 2:
        raise InputError(f"{path}: is greyscale with transparency; save it as plain greyscale")
    if pages.ndim < 2:
        raise InputError(f"{path}: holds an array of shape {pages.shape}, no image")
    if pages.ndim != 2:
        raise InputError(
            f"{path}: holds a stack of shape {pages.shape}; name a page, as in {path}#0"
        )
    return _finite(path, pages)


def read_stack(path: Path) -> Array:
    """Read a sequence of greyscale frames, shape (frames, height, width).

    Raises
    ------
    InputError
        If the file cannot be used or holds fewer than two frames.
    """
    frames = read_array(path)
    if frames.ndim != 3 or len(frames) < 2 or frames.shape[-1] in (3, 4):
        raise InputError(f"{path}: is no stack of greyscale frames (shape {frames.shape})")
    _check_not_small(path, frames[0])
    return _finite(path, frames)


def read_pair(reference: Path, deformed: Path) -> tuple[Array, Array]:
    """Read the images before and after compression, which must have one size.

    Raises
    ------
    InputError
        If an image cannot be used, or their sizes differ.
    """
    I1, I2 = read_image(reference), read_image(deformed)
    _check_not_small(reference, I1)
    if I1.shape != I2.shape:
        raise InputError(
            f"{deformed}: has {_size(I2)} but {reference} has {_size(I1)};"
            " crop or resample both to one size"
        )
    return I1, I2


def read_field(path: Path, shape: tuple[int, ...] | None = None) -> Array:
    """Read a displacement field, shape (2, height, width), px.

    Raises
    ------
    InputError
        If the file is no such field, or not of the ``shape`` (height, width) wanted.
    """
    u = read_array(path)
    if u.ndim != 3 or u.shape[0] != 2:
        raise InputError(
            f"{path}: is no displacement field; wanted two pages (u1, u2), found shape {u.shape}"
        )
    if shape is not None and u.shape[1:] != shape:
        raise InputError(
            f"{path}: has {_size(u[0])} but the images have {shape[0]} x {shape[1]} px;"
            " compute the field for these images"
        )
    return _finite(path, u)


def write_image(path: Path, I: Array) -> None:
    """Write an image as float32 ImageJ TIFF."""
    write_tiff(path, I)


def write_field(path: Path, u: Array, unit: str = "px") -> None:
    """Write a field as float32 ImageJ TIFF with the pages u1 and u2."""
    write_pages(path, u, [f"u1 lateral [{unit}]", f"u2 axial [{unit}]"])


def write_pages(path: Path, pages: Array, labels: list[str]) -> None:
    """Write labelled pages, shape (n, height, width), as float32 ImageJ TIFF."""
    write_tiff(path, pages, labels)


def _finite(path: Path, values: NDArray) -> Array:
    if values.size == 0:
        raise InputError(f"{path}: holds no values (shape {values.shape})")
    if np.iscomplexobj(values):
        raise InputError(
            f"{path}: holds complex values ({values.dtype}); save their amplitude, abs(I)"
        )
    numeric = values.dtype == np.bool_ or np.issubdtype(values.dtype, np.number)
    if not numeric:
        raise InputError(f"{path}: holds {values.dtype} values; save real numbers")
    values = values.astype(np.float64)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0][-2:]
        raise InputError(
            f"{path}: {len(bad)} values are NaN or infinite, the first at row {row},"
            f" column {column}; replace or crop them"
        )
    return values


def _check_not_small(path: Path, I: NDArray) -> None:
    if min(I.shape) < SMALLEST:
        raise InputError(f"{path}: has {_size(I)}; at least {SMALLEST} x {SMALLEST} are needed")


def _grey(path: Path, colours: NDArray) -> NDArray:
    """The one channel of a greyscale image that was saved in colours."""
    if (colours[..., :3] != colours[..., :1]).any():
        raise InputError(f"{path}: is a colour image; convert it to greyscale first")
    if colours.shape[-1] == 4 and np.ptp(colours[..., 3]):
        raise InputError(f"{path}: is partly transparent; save it as plain greyscale")
    return colours[..., 0]


def _size(I: NDArray) -> str:
    return f"{I.shape[0]} x {I.shape[1]} px"
