"""Files: images and fields as TIFF, bubbles and errors as CSV.

The only module that knows file formats. Every file is written beside its place and then
moved there, so that a failure leaves nothing half-written.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import tifffile
from numpy.typing import NDArray

from eofm.errors import InputError

Array = NDArray[np.float64]

BUBBLE_COLUMNS = ("x1", "x2", "u1", "u2")


def read_image(path: Path) -> Array:
    """Read a single-page greyscale TIFF, shape (height, width).

    Raises
    ------
    InputError
        If the file is missing, unreadable, in colour, a stack, or has NaN or infinity.
    """
    pages = _read_tiff(path)
    if pages.ndim == 3 and pages.shape[-1] in (3, 4):
        raise InputError(f"{path}: is a colour image; convert it to greyscale first")
    if pages.ndim != 2:
        raise InputError(
            f"{path}: holds a stack of shape {pages.shape}; save the page you mean as one image"
        )
    return _finite(path, pages)


def read_pair(reference: Path, deformed: Path) -> tuple[Array, Array]:
    """Read the images before and after compression, which must have one size.

    Raises
    ------
    InputError
        If an image cannot be used, or their sizes differ.
    """
    I1, I2 = read_image(reference), read_image(deformed)
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
    u = _read_tiff(path)
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
    with replacing(path) as temporary:
        tifffile.imwrite(temporary, I.astype(np.float32), imagej=True)


def write_field(path: Path, u: Array) -> None:
    """Write a field as float32 ImageJ TIFF with the pages u1 and u2, px."""
    with replacing(path) as temporary:
        tifffile.imwrite(
            temporary,
            u.astype(np.float32),
            imagej=True,
            metadata={"axes": "CYX", "Labels": ["u1 lateral [px]", "u2 axial [px]"]},
        )


def read_bubbles(path: Path) -> pd.DataFrame:
    """Read a table of bubbles with at least the columns x1, x2, u1, u2, px.

    Raises
    ------
    InputError
        If the file is missing, is no table, lacks a column or holds something else
        than finite numbers in it.
    """
    try:
        table = pd.read_csv(path)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(f"{path}: cannot be read as a CSV table ({_one_line(error)})") from None
    missing = [name for name in BUBBLE_COLUMNS if name not in table]
    if missing:
        raise InputError(
            f"{path}: lacks the column {missing[0]}; a table of bubbles has"
            f" {', '.join(BUBBLE_COLUMNS)}, as eofm track writes it"
        )
    for name in BUBBLE_COLUMNS:
        column = pd.to_numeric(table[name], errors="coerce")
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise InputError(
                f"{path}: {name} in line {bad[0] + 2} is no finite number; mend or delete the line"
            )
        table[name] = column.astype(float)
    return table


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write a table as CSV, with six decimals."""
    with replacing(path) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6f", lineterminator="\n")


def _read_tiff(path: Path) -> NDArray:
    try:
        return tifffile.imread(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except Exception as error:  # tifffile raises whatever the damage leads to
        raise InputError(f"{path}: cannot be read as TIFF ({_one_line(error)})") from None


def _finite(path: Path, values: NDArray) -> Array:
    if not np.issubdtype(values.dtype, np.number) or np.iscomplexobj(values):
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


def _size(I: NDArray) -> str:
    return f"{I.shape[0]} x {I.shape[1]} px"


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def check_folder(path: Path) -> None:
    """Refuse a file to write whose folder does not exist."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file that takes the place of ``path`` once it is complete."""
    check_folder(path)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
