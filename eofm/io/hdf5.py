"""HDF5 files, such as those of MATLAB 7.3, read in a process of their own.

The library may crash on a damaged file, or never end. What it does there ends with the child,
whose memory and time are limited. Run as a script, this module is that child.
"""

import io
import json
import subprocess
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

# What the reader itself takes, beside the array, bytes.
READER = 1 << 30


def read_hdf5(
    path: str, part: str, largest: int, seconds: float
) -> tuple[list[str], NDArray | None]:
    """The data sets of a file, and that which is named, or the only one that there is.

    Parameters
    ----------
    path, part : str
        File, and name of the data set or empty.
    largest : int
        Bytes that the array may take.
    seconds : float
        Time that reading may take.

    Returns
    -------
    names : list of str
    array : ndarray, or None
        None where the choice is open.

    Raises
    ------
    ValueError
        If it cannot be read, with the reason in one line.
    """
    command = [sys.executable, "-P", __file__, path, part, str(largest), str(int(seconds))]
    try:
        child = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=2 * seconds
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"it takes longer than {2 * seconds:g} s") from None
    if child.returncode < 0:
        raise ValueError(f"it ends its reader by signal {-child.returncode}; it is damaged")
    if child.returncode:
        lines = child.stderr.decode(errors="replace").strip().splitlines()
        raise ValueError(lines[-1] if lines else "its reader failed")
    names, _, array = child.stdout.partition(b"\n")
    return json.loads(names), np.load(io.BytesIO(array), allow_pickle=False) if array else None


def read(path: str, part: str, largest: int) -> tuple[list[str], NDArray | None]:
    """The same, in this process."""
    import h5py

    with h5py.File(path, "r", locking=False) as file:
        # Links may lead to other files, and MATLAB has none.
        hard = [k for k in file if isinstance(file.get(k, getlink=True), h5py.HardLink)]
        found = {k: file[k] for k in hard if file.get(k, getclass=True) is h5py.Dataset}
        found = {k: v for k, v in found.items() if _is_numeric(v)}
        if part not in found and (part or len(found) != 1):
            return list(found), None
        data = found[part or next(iter(found))]
        if data.is_virtual or data.external:
            raise ValueError("its values are in another file; save them in one")
        if data.dtype.kind in "cV":
            raise ValueError("it holds complex values; save their amplitude, abs(I)")
        size = data.size * max(data.dtype.itemsize, 8)
        if size > largest:
            raise ValueError(
                f"it asks for {size / 2**30:.3g} GiB (shape {data.shape}), more than the"
                f" {largest / 2**30:.3g} GiB allowed; crop it, or allow more by --max-size"
            )
        return list(found), data[()].T


def _is_numeric(data: Any) -> bool:
    text = data.attrs.get("MATLAB_class") == b"char"
    return data.dtype.kind in "biufcV" and data.ndim > 1 and not text


def main(path: str, part: str, largest: str, seconds: str) -> None:
    """Read within limits, and pass the arrays on by standard output."""
    try:
        import resource
    except ImportError:  # not on Windows, which keeps the limit of time
        pass
    else:
        most = READER + 4 * int(largest)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    try:
        names, array = read(path, part, int(largest))
    except Exception as error:
        sys.exit(" ".join(str(error).split()) or type(error).__name__)
    sys.stdout.buffer.write(json.dumps(names).encode() + b"\n")
    if array is not None:
        np.save(sys.stdout.buffer, array)


if __name__ == "__main__":
    main(*sys.argv[1:])
