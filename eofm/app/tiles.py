"""Steps for volumes in tiles: those of the command ``eofm`` that a workflow runs as jobs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from eofm.app.options import Step, reads, writes
from eofm.settings import Estimation, Pair, PartOfScale, Tiling

if TYPE_CHECKING:
    from eofm.flow.trust import Trust

Work = Annotated[Path, reads("folder that `eofm coarse` has made")]


def coarse(
    pair: Pair,
    estimation: Estimation,
    tiling: Tiling,
    *,
    work: Annotated[Path, writes("folder for what passes from step to step")],
    settings: Annotated[Path | None, reads("file of settings (YAML)")] = None,
) -> None:
    r"""Begin a volume in tiles: what all tiles share, and the coarse scales.

    A volume that does not fit into the memory is cut into tiles that overlap, each a process of
    its own, here or on a cluster:

      eofm coarse --reference before.zarr --deformed after.zarr --tiles 2 2 2 --work work
      for n in 0 1 2 3 4 5 6 7; do eofm tile work --number $n; done
      eofm gather work --folder results/mine

    The volumes are read window by window, so they are Zarr, NumPy (.npy) or uncompressed TIFF.
    From 9 tiles on, more than one scale is solved in tiles (level 1 is half as fine as the
    volume, and so on): the steps say which comes next. A column `tiles` in the table of samples
    makes the workflow do all that.
    """
    from eofm.analysis.tiles import coarse

    print(coarse(pair, estimation, tiling, work))


def tile(work: Work, part: PartOfScale) -> None:
    """Estimate one tile of a volume, from the field of the scale before.

    eofm tile work --number 3

    Tiles of one level do not wait for each other. The memory is that of a volume as large as the
    tile with its overlap, however large the whole is. The field, px on level 0, stays in the folder
    of the work, for `eofm gather`.
    """
    from eofm.analysis.tiles import tile

    tile(work, part.level, part.number)


def gather(
    work: Work,
    part: PartOfScale,
    *,
    folder: Annotated[Path | None, writes("folder to write the results to")] = None,
) -> "Trust | None":
    """Make one field of the tiles of a level; on level 0 also strain, figures and the summary.

      eofm gather work --folder results/mine

    Tiles pass over smoothly into each other. On level 0 the results go to the folder:
    displacement.tif (px), displacement_um.tif, deviation.tif, strain.tif, strain_invariants.tif,
    trust.tif, results.vti, summary.json, figures and report.html, all of them or nothing. Where
    the images do not bear the estimate out, it says why; if they contradict it, the exit status
    is 3.
    """
    from eofm.analysis.tiles import gather
    from eofm.errors import InputError

    if part.level:
        print(gather(work, part.level))
        return None
    if folder is None:
        raise InputError("folder: say where the results go, --folder results/mine")
    from eofm.analysis.gathered import write_gathered

    return write_gathered(work, folder)


STEPS: tuple[Step, ...] = (coarse, tile, gather)
