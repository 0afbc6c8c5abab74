"""What a file holds, checked: an image or a volume, a stack, a pair, a field; and writing them."""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.grid import Array, precision
from eofm.io.formats import read_array
from eofm.io.scan import Scan
from eofm.io.tiff import write_tiff

# Smaller images hold no motion to speak of.
SMALLEST = 8
NAMES = {2: "an image", 3: "a volume"}
MEANINGS = {"T": "times", "C": "channels", "Z": "slices", "Q": "pages"}
COMPONENTS = ("u1 lateral", "u2 axial", "u3 elevational")

logger = logging.getLogger("eofm")


def read_scan(path: str | Path, ndim: int | None = None) -> Scan:
    """Read a greyscale image, shape (height, width), or volume, (depth, height, width).

    Images are float64, volumes float32; of complex values it is the amplitude, which the log says.
    ``FILE#3`` is page 3 (from 0) of a stack, ``FILE#name`` a variable of a file that has several,
    ``FILE#name#3`` a page of it.

    Parameters
    ----------
    path : str or Path
    ndim : int, optional
        Number of axes wanted; None takes what there is.

    Returns
    -------
    Scan
        Its values are float64 of images and float32 of volumes.

    Raises
    ------
    InputError
        If the file is missing, unreadable, in colour, a stack in time or of channels, of the other
        kind than wanted, or has NaN or infinity.
    """
    scan = one_image(path, _one_colour(path, read_array(path)), ndim)
    values = amplitude(path, scan.values)
    return Scan(check_finite(path, values, values.ndim), scan.axes, scan.sizes)


def one_image(path: str | Path, scan: Scan, ndim: int | None = None) -> Scan:
    """The same without axes along which there is nothing, if it is one image or volume."""
    axes, values = scan.axes, scan.values
    if values.ndim < 2:
        raise InputError(f"{path}: holds an array of shape {values.shape}, no image")
    # Axes along which there is nothing are none.
    flat = [axis for axis in range(values.ndim - 2) if values.shape[axis] == 1]
    values = values.reshape([n for axis, n in enumerate(values.shape) if axis not in flat])
    axes = "".join(letter for axis, letter in enumerate(axes) if axis not in flat)
    if ndim == 2 and values.ndim > 2:
        raise InputError(
            f"{path}: holds a stack of shape {values.shape} where an image is wanted; name a page,"
            f" as in {path}#0"
        )
    if axes[-2:] != "YX":
        raise InputError(f"{path}: its axes are {axes}; save an image or volume (axes YX or ZYX)")
    wrong = next((axis for axis in axes[:-2] if axis in "TC"), None)
    if wrong == "T" and values.ndim == 3:
        raise InputError(
            f"{path}: its {values.shape[0]} pages are times (T), no slices; name one, as in"
            f" {path}#0, give the file as frames, or save it with the axes ZYX"
        )
    if wrong or values.ndim > 3:
        pages = zip(values.shape[:-2], axes[:-2], strict=True)
        said = ", ".join(f"{n} {MEANINGS[a]}" for n, a in pages)
        raise InputError(f"{path}: holds {said}; save one image or volume (axes YX or ZYX)")
    if ndim not in (None, values.ndim):
        raise InputError(f"{path}: is {NAMES[values.ndim]} where {NAMES[3]} is wanted")
    return Scan(values, axes, scan.sizes)


def read_image(path: str | Path, ndim: int | None = None) -> Array:
    """Read the values of an image or volume, see `read_scan`.

    Parameters
    ----------
    path : str or Path
    ndim : int, optional
        Number of axes wanted; None takes what there is.

    Returns
    -------
    ndarray, shape (height, width) or (depth, height, width)
    """
    return read_scan(path, ndim).values


def read_stack(path: str | Path) -> Scan:
    """Read a sequence of greyscale frames, shape (frames, height, width), float64.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    InputError
        If the file cannot be used or holds fewer than two frames.
    """
    scan = _one_colour(path, read_array(path))
    frames = scan.values
    if frames.ndim != 3 or len(frames) < 2:
        raise InputError(f"{path}: is no stack of greyscale frames (shape {frames.shape})")
    if scan.axes[0] in "CZ":
        logger.warning(f"{path}: {MEANINGS[scan.axes[0]]} ({scan.axes[0]}) are taken for frames")
    _check_not_small(path, frames[0])
    return Scan(check_finite(path, amplitude(path, frames), 2), scan.axes, scan.sizes)


def read_scans(
    reference: str | Path, deformed: str | Path, ndim: int | None = None
) -> tuple[Scan, Scan]:
    """Read two images or volumes, before and after compression, which must have one size.

    Parameters
    ----------
    reference, deformed : str or Path
    ndim : int, optional
        Number of axes wanted; None takes what there is.

    Raises
    ------
    InputError
        If one cannot be used, see `read_scan`, or their sizes differ.
    """
    first, second = read_scan(reference, ndim), read_scan(deformed, ndim)
    _check_not_small(reference, first.values)
    if first.values.shape != second.values.shape:
        raise InputError(
            f"{deformed}: has {_size(second.values)} but {reference} has {_size(first.values)};"
            " crop or resample both to one size"
        )
    return first, second


def read_pair(
    reference: str | Path, deformed: str | Path, ndim: int | None = None
) -> tuple[Array, Array]:
    """Read the values of two images or volumes of one size, see `read_scans`.

    Parameters
    ----------
    reference, deformed : str or Path
    ndim : int, optional
        Number of axes wanted; None takes what there is.

    Returns
    -------
    I1, I2 : ndarray, shape (height, width) or (depth, height, width)
    """
    first, second = read_scans(reference, deformed, ndim)
    return first.values, second.values


def read_field(
    path: str | Path, shape: tuple[int, ...] | None = None, ndim: int | None = None
) -> Array:
    """Read a displacement field, px, shape (2, height, width) or (3, depth, height, width).

    Parameters
    ----------
    path : str or Path
    shape : tuple of int, optional
        Shape of the images that it has to belong to.
    ndim : int, optional
        Number of their axes, where only that matters.

    Raises
    ------
    InputError
        If the file is no such field, or not of the shape or number of axes wanted.
    """
    scan = read_array(path)
    u = scan.values
    if scan.axes == "ZCYX":
        u = np.moveaxis(u, 1, 0)
    if (u.ndim, *u.shape[:1]) not in ((3, 2), (4, 3)):
        raise InputError(
            f"{path}: is no displacement field; wanted two pages (u1, u2), or three for each slice"
            f" (u1, u2, u3), found shape {u.shape}"
        )
    if np.iscomplexobj(u):
        raise InputError(f"{path}: holds complex values, no displacement")
    if shape is not None and u.shape[1:] != shape:
        raise InputError(
            f"{path}: has {_size(u[0])} but the images have {_px(shape)};"
            " compute the field for these images"
        )
    if ndim not in (None, u.ndim - 1):
        raise InputError(
            f"{path}: is the field of {NAMES[u.ndim - 1]} where that of {NAMES[6 - u.ndim]} is"
            " wanted"
        )
    return check_finite(path, u, u.ndim - 1)


def write_image(path: str | Path, I: Array, sides: Sequence[float] | None = None) -> None:
    """Write an image or volume as float32 ImageJ TIFF.

    Parameters
    ----------
    path : str or Path
    I : ndarray, shape (height, width) or (depth, height, width)
    sides : sequence, optional
        Sides of a pixel, um, lateral first.
    """
    write_tiff(path, I, sides=sides)


def write_field(
    path: str | Path,
    u: Array,
    unit: str = "px",
    sides: Sequence[float] | None = None,
    of: str = "",
) -> None:
    """Write a field as float32 ImageJ TIFF with the pages u1 and u2, of volumes u3 too.

    Parameters
    ----------
    path : str or Path
    u : ndarray, shape (ndim, ...)
    unit : str
        Its unit, for the labels.
    sides : sequence, optional
        Sides of a pixel, um, lateral first.
    of : str
        What it is if no displacement, such as "deviation".
    """
    labels = [f"{of} of {name}" if of else name for name in COMPONENTS[: len(u)]]
    write_pages(path, u, [f"{label} [{unit}]" for label in labels], sides)


def write_pages(
    path: str | Path, pages: Array, labels: list[str], sides: Sequence[float] | None = None
) -> None:
    """Write labelled images or volumes as float32 ImageJ TIFF; channels to Fiji.

    Parameters
    ----------
    path : str or Path
    pages : ndarray, shape (n, ...)
    labels : list of str
        What each of them is.
    sides : sequence, optional
        Sides of a pixel, um, lateral first.
    """
    write_tiff(path, np.moveaxis(pages, 0, -3), labels, sides)


def amplitude(path: str | Path, values: NDArray) -> NDArray:
    """The amplitude of complex values, and the log says so; others as they are."""
    if not np.iscomplexobj(values):
        return values
    logger.warning(f"{path}: holds complex values; their amplitude is taken")
    return np.abs(values)


def check_finite(path: str | Path, values: NDArray, ndim: int) -> Array:
    """The values as numbers to compute with: 8 bytes in images, 4 in volumes."""
    if values.size == 0:
        raise InputError(f"{path}: holds no values (shape {values.shape})")
    numeric = values.dtype == np.bool_ or np.issubdtype(values.dtype, np.number)
    if not numeric:
        raise InputError(f"{path}: holds {values.dtype} values; save real numbers")
    with np.errstate(over="ignore"):  # what is beyond single precision is infinite, and refused
        values = values.astype(precision(ndim), copy=False)
    # Page by page: a volume's truth values alone would be many.
    if all(np.isfinite(page).all() for page in values.reshape(-1, *values.shape[-2:])):
        return values
    bad = np.argwhere(~np.isfinite(values))
    names = ("slice", "row", "column")[-ndim:]
    place = ", ".join(f"{name} {n}" for name, n in zip(names, bad[0][-ndim:], strict=True))
    raise InputError(
        f"{path}: {len(bad)} values are NaN or infinite, the first at {place}; replace or crop them"
    )


def _check_not_small(path: str | Path, I: NDArray) -> None:
    if min(I.shape) < SMALLEST:
        least = " x ".join([str(SMALLEST)] * I.ndim)
        raise InputError(f"{path}: has {_size(I)}; at least {least} are needed")


def _one_colour(path: str | Path, scan: Scan) -> Scan:
    """The one channel of greyscale that was saved in colours."""
    if not scan.axes.endswith("S"):
        return scan
    colours = scan.values
    if colours.shape[-1] == 2:
        raise InputError(f"{path}: is greyscale with transparency; save it as plain greyscale")
    if (colours[..., :3] != colours[..., :1]).any():
        raise InputError(f"{path}: is a colour image; convert it to greyscale first")
    if colours.shape[-1] == 4 and np.ptp(colours[..., 3]):
        raise InputError(f"{path}: is partly transparent; save it as plain greyscale")
    return Scan(colours[..., 0], scan.axes[:-1], scan.sizes)


def _size(I: NDArray) -> str:
    return _px(I.shape)


def _px(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape)) + " px"
