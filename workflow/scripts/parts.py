"""Rows of the table of samples in parts: rows of one part share a process, which starts once.

What a part asks for follows the size of its images; `reliability.py resources` compares that with
the benchmark files of a run.
"""

import math
import os
from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import NamedTuple

from commands import sample_files

from eofm import io
from eofm.errors import InputError

# At most so many rows, and so many pixels, of a part; tables of a few rows run side by side.
ROWS, PIXELS, AT_ONCE = 20, 2_000_000, 8
# Files of different sizes that are opened while a table is planned, at most.
OPENED = 200
# Of processes that analyse images, and volumes: MB and seconds of any, and of a million pixels.
MB = {2: (300, 660), 3: (300, 700)}
SECONDS = {2: (2.5, 40.0), 3: (2.5, 200.0)}
# MB of what starts the process of the rows in a job of Slurm.
SNAKEMAKE = 250
# Seconds of any row, whatever its size.
ROW = 1.0
# Minutes for what the processor does not do, such as to start on a busy file system; and how much
# slower than the machine of these figures another may be.
START, SLOWER = 3, 1.4


class Size(NamedTuple):
    """Pixels of a row, of all its frames, and how many axes one of them has."""

    pixels: int
    ndim: int


def parts(samples: dict[str, dict[str, str]]) -> list[list[str]]:
    """Names of the rows of each part, in the order of the table."""
    rows = min(ROWS, ceil(len(samples) / AT_ONCE))
    found: list[list[str]] = []
    room, left = 0, 0
    for name, row in samples.items():
        pixels = size(row).pixels
        if not room or pixels > left:
            found.append([])
            room, left = rows, PIXELS
        found[-1].append(name)
        room, left = room - 1, left - pixels
    return found


def size(row: dict[str, str]) -> Size:
    """Size of the region of interest, or of all frames.

    Of files that are not there yet nothing is known: they count as small images.
    """
    files = [f for f in sample_files(row) if f in _images(row) and os.path.isfile(f)]
    whole = max((_of_file(Path(f)) for f in files), default=Size(100_000, 2))
    if "frames" in row:
        whole = Size(whole.pixels, 2)
    try:
        sides = [abs(int(word)) for word in row["roi"].split()]
    except (KeyError, ValueError):
        return whole
    if len(sides) == 4 and whole.ndim == 3:
        return whole
    return Size(min(whole.pixels, math.prod(sides[len(sides) // 2 :])), whole.ndim)


def _images(row: dict[str, str]) -> list[str]:
    return [row.get(key, "").partition("#")[0] for key in ("reference", "deformed", "frames")]


def _of_file(path: Path) -> Size:
    """What the header of a file says, or that a byte is a pixel.

    Of files of one kind and length only the first is opened, so that thousands of rows are
    planned in a second.
    """
    key = path.suffix, path.stat().st_size
    if key not in KNOWN and len(KNOWN) < OPENED:
        try:
            shape = io.open_stored(path).shape
            KNOWN[key] = Size(math.prod(shape), len(shape))
        except InputError:  # its step will say what is wrong, or reads it as a whole
            KNOWN[key] = Size(key[1], 2)
    return KNOWN.get(key, Size(key[1], 2))


KNOWN: dict[tuple[str, int], Size] = {}


def memory(sizes: Sequence[Size]) -> int:
    """Memory of a process that analyses rows of these sizes one after the other, MB."""
    return max(ceil(MB[n][0] + pixels / 1e6 * MB[n][1]) for pixels, n in sizes)


def asked_memory(sizes: Sequence[Size]) -> int:
    """Memory to ask for, MB: on a cluster, a job has processes of Snakemake as well."""
    return SNAKEMAKE + ceil(1.1 * memory(sizes))


def seconds(sizes: Sequence[Size]) -> float:
    """Time of the processor that it takes, s."""
    start = max(SECONDS[n][0] for _, n in sizes)
    return start + sum(ROW + pixels / 1e6 * SECONDS[n][1] for pixels, n in sizes)


def minutes(sizes: Sequence[Size]) -> int:
    """Run time of rows of these sizes to ask for, minutes."""
    return START + ceil(SLOWER * seconds(sizes) / 60)
