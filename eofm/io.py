"""Files: images, fields as TIFF, tables as CSV, summaries as JSON.

The only module that knows file formats. Every file is written beside its place and then
moved there, so that a failure leaves nothing half-written.
"""

import json
import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tifffile
import yaml
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.grid import Array

if TYPE_CHECKING:
    import pandas as pd


# Smaller images hold no motion to speak of.
SMALLEST = 8

# Its warnings about damaged files come before our own line on them.
logging.getLogger("tifffile").setLevel(logging.CRITICAL)

BUBBLE_COLUMNS = ("x1", "x2", "u1", "u2")


def read_image(path: Path) -> Array:
    """Read a greyscale image, shape (height, width): TIFF, PNG, NumPy or MATLAB.

    ``FILE#3`` is page 3 (from 0) of a stack, ``FILE#name`` a variable of a MATLAB or NumPy file,
    ``FILE#name#3`` a page of it.

    Raises
    ------
    InputError
        If the file is missing, unreadable, in colour, a stack, or has NaN or infinity.
    """
    pages = _read_array(path)
    if pages.ndim == 3 and pages.shape[-1] in (3, 4):
        raise InputError(f"{path}: is a colour image; convert it to greyscale first")
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
    frames = _read_array(path)
    if frames.ndim != 3 or len(frames) < 2 or frames.shape[-1] in (3, 4):
        raise InputError(f"{path}: is no stack of greyscale frames (shape {frames.shape})")
    return _finite(path, frames)


def read_pair(reference: Path, deformed: Path) -> tuple[Array, Array]:
    """Read the images before and after compression, which must have one size.

    Raises
    ------
    InputError
        If an image cannot be used, or their sizes differ.
    """
    I1, I2 = read_image(reference), read_image(deformed)
    if min(I1.shape) < SMALLEST:
        raise InputError(
            f"{reference}: has {_size(I1)}; at least {SMALLEST} x {SMALLEST} are needed"
        )
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
    u = _read_array(path)
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


def write_field(path: Path, u: Array, unit: str = "px") -> None:
    """Write a field as float32 ImageJ TIFF with the pages u1 and u2."""
    write_pages(path, u, [f"u1 lateral [{unit}]", f"u2 axial [{unit}]"])


def write_pages(path: Path, pages: Array, labels: list[str]) -> None:
    """Write labelled pages, shape (n, height, width), as float32 ImageJ TIFF."""
    with replacing(path) as temporary:
        tifffile.imwrite(
            temporary,
            pages.astype(np.float32),
            imagej=True,
            metadata={"axes": "CYX", "Labels": labels},
        )


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write a summary, indented."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values, indent=2) + "\n")


def read_bubbles(path: Path) -> "pd.DataFrame":
    """Read a table of bubbles with at least the columns x1, x2, u1, u2, px."""
    return read_columns(path, BUBBLE_COLUMNS)


def read_columns(path: Path, columns: tuple[str, ...]) -> "pd.DataFrame":
    """Read a CSV table that has at least some columns of numbers.

    Raises
    ------
    InputError
        If the file is missing, is no table, lacks a column or holds something else
        than finite numbers in it.
    """
    import pandas as pd  # takes a quarter of a second that images alone do not need

    try:
        table = pd.read_csv(path)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(f"{path}: cannot be read as a CSV table ({_one_line(error)})") from None
    missing = [name for name in columns if name not in table]
    if missing:
        raise InputError(
            f"{path}: lacks the column {missing[0]}; wanted are the columns {', '.join(columns)}"
        )
    for name in columns:
        column = pd.to_numeric(table[name], errors="coerce")
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise InputError(
                f"{path}: {name} in line {bad[0] + 2} is no finite number; mend or delete the line"
            )
        table[name] = column.astype(float)
    return table


def read_settings(path: Path) -> dict[str, Any]:
    """Read a YAML file of names and values.

    Raises
    ------
    InputError
        If the file is missing or holds something else.
    """
    try:
        values = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read as YAML ({_one_line(error)})") from None
    if not isinstance(values, dict) or not all(isinstance(name, str) for name in values):
        raise InputError(f"{path}: holds no names and values")
    return values


def write_table(path: Path, table: "pd.DataFrame") -> None:
    """Write a table as CSV, with six decimals."""
    with replacing(path) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6f", lineterminator="\n")


def _read_array(path: Path) -> NDArray:
    """The array of a file, or the variable and page of it named after ``#``."""
    name, parts = str(path), []
    if not path.exists():
        folder, _, last = name.rpartition("/")
        last, *parts = last.split("#")
        name = f"{folder}/{last}" if "/" in name else last
    if not Path(name).exists():
        raise InputError(f"{name}: no such file")
    kind = Path(name).suffix.lower()
    pages = [part for part in parts if part.isdigit()]
    variables = [part for part in parts if not part.isdigit()]
    if len(pages) > 1 or len(variables) > (kind in (".mat", ".npz")) or (pages and kind == ".png"):
        raise InputError(f"{path}: cannot tell what #{'#'.join(parts)} means for such a file")
    read = READERS.get(kind, _read_tiff)
    try:
        array = read(name, "".join(variables))
    except InputError:
        raise
    except Exception as error:  # readers raise whatever the damage leads to
        label = kind[1:].upper() if kind in READERS else "TIFF"
        raise InputError(f"{name}: cannot be read as {label} ({_one_line(error)})") from None
    if not pages:
        return array
    page = int(pages[0])
    if array.ndim < 3 or page >= len(array):
        raise InputError(f"{path}: has no page {page}; the file holds shape {array.shape}")
    return array[page]


def _read_tiff(name: str, part: str) -> NDArray:
    return tifffile.imread(name)


def _read_png(name: str, part: str) -> NDArray:
    from skimage.io import imread

    return imread(name)


def _read_numpy(name: str, part: str) -> NDArray:
    loaded = np.load(name, allow_pickle=False)
    return loaded if isinstance(loaded, np.ndarray) else _variable(name, dict(loaded), part)


def _read_matlab(name: str, part: str) -> NDArray:
    """MATLAB 5 by SciPy; MATLAB 7.3 is HDF5, whose axes are the other way round."""
    import h5py
    from scipy.io import loadmat

    if h5py.is_hdf5(name):
        with h5py.File(name) as file:
            found = {k: v[()].T for k, v in file.items() if isinstance(v, h5py.Dataset)}
    else:
        found = {k: v for k, v in loadmat(name).items() if not k.startswith("__")}
    # MATLAB keeps pages last.
    found = {k: np.moveaxis(v, -1, 0) if v.ndim == 3 else v for k, v in found.items()}
    return _variable(name, found, part)


def _variable(name: str, found: dict[str, NDArray], part: str) -> NDArray:
    if part in found:
        return found[part]
    if len(found) == 1 and not part:
        return next(iter(found.values()))
    raise InputError(
        f"{name}: name a variable, as in {name}#{next(iter(found), 'I')}; it holds"
        f" {', '.join(found) or 'none'}"
    )


READERS = {".png": _read_png, ".npy": _read_numpy, ".npz": _read_numpy, ".mat": _read_matlab}


def _finite(path: Path, values: NDArray) -> Array:
    numeric = values.dtype == np.bool_ or np.issubdtype(values.dtype, np.number)
    if not numeric or np.iscomplexobj(values):
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
    """Refuse a file to write that is a folder, or whose folder does not exist."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file in it")


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
