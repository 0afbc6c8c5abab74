"""How large an array a file or a model may ask for, and how long a foreign reader may take."""

import math
import os
import sys
from collections.abc import Sequence

from eofm.errors import InputError

# Images are computed with as numbers of eight bytes.
ITEM = 8
# Part of the memory that one file may fill; an estimate takes several arrays of that size.
PART = 0.25
# Part of the memory that a computation may fill.
MOST = 0.75
# Seconds that a reader in a process of its own may take.
PATIENCE = 60
# A file of settings larger than this is none.
LARGEST_TEXT = 1 << 20

_largest: int | None = None


def limit_size(gigabytes: float | None) -> None:
    """Set the largest array that a file may hold, in GiB; None is a quarter of the memory.

    Raises
    ------
    InputError
        If it is no positive number.
    """
    global _largest
    if gigabytes is not None and not 0 < gigabytes < math.inf:
        raise InputError(f"max-size: wants a positive number of GiB (got {gigabytes:g})")
    _largest = None if gigabytes is None else int(gigabytes * 2**30)


def largest() -> int:
    """Bytes that the array of a file may take."""
    return _largest if _largest is not None else int(PART * memory())


def check_size(name: str, shape: Sequence[int], item: int = ITEM) -> None:
    """Refuse an array by what the header says of it, before anything is read.

    Raises
    ------
    InputError
        If it takes more than `largest`.
    """
    size = math.prod(map(int, shape)) * max(item, ITEM)
    if size > largest():
        raise InputError(
            f"{name}: asks for {size / 2**30:.3g} GiB (shape {tuple(map(int, shape))}), more than"
            f" the {largest() / 2**30:.3g} GiB allowed; crop it, or allow more by --max-size"
        )


def check_memory(what: str, size: float, instead: str) -> None:
    """Refuse a computation that takes more memory than there is, before it begins.

    Parameters
    ----------
    what : str
        What takes it.
    size : float
        How much it takes, bytes.
    instead : str
        What to do about it.

    Raises
    ------
    InputError
        If so.
    """
    most = MOST * memory()
    if size > most:
        raise InputError(
            f"{what} take {size / 2**30:.3g} GiB of memory, more than the {most / 2**30:.3g} there"
            f" are for it; {instead}"
        )


def memory() -> int:
    """Bytes of memory that this process may fill: the machine's, a container's, or a shell's."""
    found = [sys.maxsize]
    if hasattr(os, "sysconf"):
        found.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    try:
        import resource

        found += [n for n in resource.getrlimit(resource.RLIMIT_AS) if n != resource.RLIM_INFINITY]
        with open("/sys/fs/cgroup/memory.max") as file:
            found.append(int(file.read()))
    except (ImportError, OSError, ValueError):  # not Linux, or no limit
        pass
    return min(found)
