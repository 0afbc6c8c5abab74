"""Files that a library reads which may crash or never end: in a process of its own.

What it does there ends with the child, whose memory and time are limited. The readers are the
modules `hdf5`, `omezarr`, `nifti` and `dicom`. Each has a function ``read(path, part, largest)``
that returns the names of all arrays, the chosen one or None, its axes, and the sizes of its pixels
with their units as far as the file states them; and each imports nothing of ours, so that the
child starts soon. Run as a script, this module is that child.
"""

import json
import runpy
import subprocess
import sys
import tempfile
import warnings
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# What a reader itself takes, beside the array, bytes.
READER = 1 << 30
# What a reader returns.
Said = tuple[list[str], NDArray | None, str, dict[str, tuple[float, str]]]


def read_apart(reader: str, path: str, part: str, largest: int, seconds: float) -> Said:
    """What a reader returns, from a child.

    Parameters
    ----------
    reader : str
        Name of its module.
    path, part : str
        File, and name of the array or empty.
    largest : int
        Bytes that the array may take.
    seconds : float
        Time that reading may take.

    Raises
    ------
    ValueError
        If it cannot be read, with the reason in one line.
    """
    file = str(Path(__file__).with_name(f"{reader}.py"))
    words = [file, str(Path(path).absolute()), part, str(largest), str(int(seconds))]
    command = [sys.executable, "-P", __file__, *words]
    with tempfile.TemporaryFile() as out:
        try:
            child = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.PIPE,
                timeout=2 * seconds,
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"it takes longer than {2 * seconds:g} s") from None
        if child.returncode < 0:
            raise ValueError(f"it ends its reader by signal {-child.returncode}; it is damaged")
        if child.returncode:
            lines = child.stderr.decode(errors="replace").strip().splitlines()
            raise ValueError(lines[-1] if lines else "its reader failed")
        out.seek(0)
        names, found, axes, sizes = json.loads(out.readline())
        array = np.lib.format.read_array(out, allow_pickle=False) if found else None
    return names, array, axes, sizes


def installed(library: str) -> bool:
    """Whether a library that a reader wants is there."""
    return find_spec(library) is not None


def main(reader: str, path: str, part: str, largest: str, seconds: str) -> None:
    """Read within limits, and pass the array on by standard output."""
    try:
        import resource
    except ImportError:  # not on Windows, which keeps the limit of time
        pass
    else:
        most = READER + 4 * int(largest)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    # Libraries may print, and warn of much.
    warnings.simplefilter("ignore")
    out, sys.stdout = sys.stdout.buffer, sys.stderr
    try:
        names, array, axes, sizes = runpy.run_path(reader)["read"](path, part, int(largest))
    except Exception as error:
        sys.exit(" ".join(str(error).split()) or type(error).__name__)
    said = names, array is not None, axes, sizes
    out.write(json.dumps(said).encode() + b"\n")
    if array is not None:
        np.save(out, array)
    out.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
