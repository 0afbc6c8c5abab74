"""Rows of the table of samples in parts: rows of one part share a process, which starts once."""

import os
from math import ceil

from commands import sample_files

# At most so many rows, and so many pixels, of a part; tables of a few rows run side by side.
ROWS, PIXELS, AT_ONCE = 20, 2_000_000, 8


def parts(samples: dict[str, dict[str, str]]) -> list[list[str]]:
    """Names of the rows of each part, in the order of the table."""
    rows = min(ROWS, ceil(len(samples) / AT_ONCE))
    found: list[list[str]] = []
    room, left = 0, 0
    for name, row in samples.items():
        size = pixels(row)
        if not room or size > left:
            found.append([])
            room, left = rows, PIXELS
        found[-1].append(name)
        room, left = room - 1, left - size
    return found


def pixels(row: dict[str, str]) -> int:
    """Pixels of the region of interest, or of all frames, as the sizes of files say them.

    Files are not opened, so that thousands of rows are planned in a second; a byte counts as a
    pixel, of what is not there yet there are few.
    """
    files = [f for f in sample_files(row) if f in _images(row) and os.path.isfile(f)]
    whole = max((os.path.getsize(f) for f in files), default=100_000)
    try:
        _, _, width, height = (int(word) for word in row["roi"].split())
    except (KeyError, ValueError):
        return whole
    return min(whole, abs(width * height))


def _images(row: dict[str, str]) -> list[str]:
    return [row.get(key, "").partition("#")[0] for key in ("reference", "deformed", "frames")]


def memory(size: int) -> int:
    """Memory of a process whose largest row has so many pixels, MB."""
    return 450 + ceil(size / 1000 * MB_PER_1000)


def minutes(sizes: list[int]) -> int:
    """Run time of rows of these sizes, minutes, with room for a slow machine."""
    return 2 + ceil(sum(3 + size / 20_000 for size in sizes) / 60)


# Guessed from one process that analysed rows of 100 x 180 px in 415 MB.
MB_PER_1000 = 0.5
