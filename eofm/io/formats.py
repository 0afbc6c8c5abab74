"""The array of a file of any format, or the variable and page of it that is named."""

import os
from collections.abc import Callable
from pathlib import Path

from eofm.errors import InputError
from eofm.io.apart import installed, read_apart
from eofm.io.headed import read_mha, read_nrrd
from eofm.io.limits import PATIENCE, largest
from eofm.io.matlab import read_matlab
from eofm.io.origin import reading
from eofm.io.plain import read_numpy, read_png
from eofm.io.scan import Scan, choose, micrometres
from eofm.io.thorlabs import read_oct
from eofm.io.tiff import read_tiff

# What reads a file, or the array of it that is named.
Reader = Callable[[str, str], Scan]
# First bytes of TIFF and BigTIFF in both orders.
TIFFS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def read_array(path: str | Path) -> Scan:
    """The array of a file, or the variable and page of it named after ``#``.

    Raises
    ------
    InputError
        If the file is missing, damaged, too large, of no format known, or does not hold what is
        named.
    """
    name, parts = split(str(path))
    if not _is_folder(name):
        check_is_file(name, "an image")
    kind, label, read = _format(name)
    pages = [part for part in parts if part.isdecimal()]
    variables = [part for part in parts if not part.isdecimal()]
    if len(pages) > 1 or len(variables) > (kind in NAMED) or (pages and kind == ".png"):
        raise InputError(f"{path}: cannot tell what #{'#'.join(parts)} means for such a file")
    try:
        with reading(Path(name)):
            scan = read(name, "".join(variables))
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{name}: there is not enough memory to read it") from None
    except Exception as error:  # readers raise whatever the damage leads to
        raise InputError(f"{name}: cannot be read as {label} ({one_line(error)})") from None
    if not pages:
        return scan
    page, array = int(pages[0]), scan.values
    if array.ndim < 3 or page >= len(array):
        raise InputError(f"{path}: has no page {page}; the file holds shape {array.shape}")
    return Scan(array[page], scan.axes[1:], scan.sizes)


def split(name: str) -> tuple[str, list[str]]:
    """The file that there is, and what is named after ``#``."""
    if os.path.exists(name):  # which is quiet about names that no file can have
        return name, []
    places = [at for at, letter in enumerate(name) if letter == "#"]
    for at in reversed(places):
        if os.path.isfile(name[:at]) or _is_folder(name[:at]):
            return name[:at], name[at + 1 :].split("#")
    folder, _, last = name.rpartition("/")
    last, *parts = last.split("#")
    return f"{folder}/{last}" if "/" in name else last, parts


def _is_folder(name: str) -> bool:
    """Whether it is a folder that counts as a file."""
    return name.rstrip("/").lower().endswith(".zarr") and os.path.isdir(name)


def _format(name: str) -> tuple[str, str, Reader]:
    """Ending, name and reader of the format of a file, by its name or else its first bytes.

    Raises
    ------
    InputError
        If it is none that we know.
    """
    lower = name.rstrip("/").lower()
    for kind, (label, read) in READERS.items():
        if lower.endswith(kind):
            return kind, label, read
    with open(name, "rb") as file:
        head = file.read(132)
    if head[:4] in TIFFS or not Path(name).suffix:
        return ".tif", *READERS[".tif"]
    if head[128:] == b"DICM":  # scanners give such files numbers for endings
        return ".dcm", *READERS[".dcm"]
    known = list(dict.fromkeys(label for label, _ in READERS.values()))
    raise InputError(
        f"{name}: is of no format known here; those are {', '.join(known[:-1])} and {known[-1]}"
    )


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


def _read_tiff(name: str, part: str) -> Scan:
    return read_tiff(name)


def _apart(reader: str, library: str, extra: str = "") -> Reader:
    """A reader in a process of its own, that says what to install where its library is missing."""

    def read(name: str, part: str) -> Scan:
        if extra and not installed(library):
            raise InputError(f"{name}: wants another package; pip install 'eofm[{extra}]'")
        names, array, axes, sizes = read_apart(reader, name, part, largest(), PATIENCE)
        if array is None:
            raise ValueError(f"there is no {choose(name, names, part)}")
        stated = {a: micrometres({a: side}, unit).get(a) for a, (side, unit) in sizes.items()}
        return Scan(array, axes, {axis: side for axis, side in stated.items() if side})

    return read


_tiff, _numpy, _hdf5 = ("TIFF", _read_tiff), ("NumPy", read_numpy), ("HDF5", _apart("hdf5", "h5py"))
_mha = ("MHA", read_mha)
_nifti = ("NIfTI", _apart("nifti", "nibabel", "medical"))
READERS: dict[str, tuple[str, Reader]] = {
    ".tif": _tiff,
    ".tiff": _tiff,
    ".png": ("PNG", read_png),
    ".npy": _numpy,
    ".npz": _numpy,
    ".mat": ("MATLAB", read_matlab),
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".hdf": _hdf5,
    ".zarr": ("Zarr", _apart("omezarr", "zarr", "zarr")),
    ".nii": _nifti,
    ".nii.gz": _nifti,
    ".dcm": ("DICOM", _apart("dicom", "pydicom", "medical")),
    ".mha": _mha,
    ".mhd": _mha,
    ".nrrd": ("NRRD", read_nrrd),
    ".oct": ("Thorlabs .oct", read_oct),
}
# Files of several arrays, each with a name.
NAMED = (".npz", ".mat", ".h5", ".hdf5", ".hdf", ".zarr", ".oct")
