"""Rows of the table of samples that are volumes in tiles: how many jobs, and how large.

The module of tiles is imported where there are any: it takes most of a second, of each job on a
cluster too.
"""

import math
from pathlib import Path

from commands import sample_files

from eofm import io
from eofm.errors import InputError
from eofm.settings import Estimation, Tiling

Row = dict[str, str]
# Memory of a process with no volume, MB; bytes for each voxel of a tile with its overlap, most of
# them for error bars; voxels that are solved in a second by one core of a slow machine.
BASE_MB, BYTES, SPEED = 450, 600, 5_000


def tiled(samples: dict[str, Row]) -> dict[str, Row]:
    """The rows that say `tiles`."""
    return {name: row for name, row in samples.items() if "tiles" in row}


def counts(row: Row, level: int = 0) -> tuple[int, ...]:
    """Numbers of tiles along the axes; one where a row says nonsense, as its first job will say."""
    from eofm.flow.tiles import counts_at

    try:
        return counts_at(Tiling.count(row["tiles"]), level, _factor(row))
    except InputError:
        return (1, 1, 1)


def levels(row: Row) -> int:
    """How many scales are solved in tiles."""
    from eofm.flow.tiles import tiled_scales

    return tiled_scales(counts(row), _factor(row))


def numbers(row: Row, level: int) -> range:
    """Numbers of the tiles of a scale."""
    return range(math.prod(counts(row, level)))


def _factor(row: Row) -> float:
    """Ratio of two scales, as the row or its file of settings says."""
    try:
        said = io.read_settings(Path(row["settings"])) if "settings" in row else {}
        value = float(row.get("factor", said.get("factor", 0.5)))
        return Estimation.parse({"factor": value}, "").factor
    except (InputError, ValueError, TypeError):
        return 0.5


def voxels(row: Row) -> int:
    """Voxels of a tile with its overlap, as the header of the volume says."""
    from eofm.flow.tiles import cut, shape_of

    whole = max((Path(f).stat().st_size for f in sample_files(row) if Path(f).is_file()), default=0)
    whole = whole or 1_000_000
    try:
        shape = io.open_stored(Path(row["reference"])).shape
        tiles = cut(shape, counts(row), int(row.get("overlap", 16)))
        return max(math.prod(shape_of(tile.region)) for tile in tiles)
    except (InputError, KeyError, ValueError):
        # It is not there yet, or its first job says what is wrong.
        return whole // math.prod(counts(row))


def tile_memory(row: Row) -> int:
    """Memory of a job, MB: that of a tile, whatever the volume."""
    return BASE_MB + math.ceil(voxels(row) * BYTES / 1e6)


def tile_minutes(row: Row, tiles: int = 1) -> int:
    """Run time of a job that reads so many tiles, minutes, with room for a slow machine."""
    return 5 + math.ceil(voxels(row) * (1 + tiles / 10) / SPEED / 60)


def tile_files(folder: str, rows: dict[str, Row], sample: str, level: str | int) -> list[str]:
    """What the tiles of a scale write."""
    return [
        f"{folder}/{sample}/tile_{level}_{number}.{kind}"
        for number in numbers(rows[sample], int(level))
        for kind in ("npy", "json")
    ]


def before_tiles(folder: str, rows: dict[str, Row], sample: str, level: str | int) -> list[str]:
    """What the tiles of a scale wait for."""
    top = levels(rows[sample]) - 1
    last = [] if int(level) == top else [f"choice_{level}.json"]
    return [f"{folder}/{sample}/{name}" for name in ["plan.json", *last]]
