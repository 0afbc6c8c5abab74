"""The results of a pair or sequence as files and figures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from eofm import io
from eofm.analysis import figures
from eofm.analysis.analyse import Analysis
from eofm.grid import componentwise
from eofm.settings import Figures

STRAIN_LABELS = ["e11 lateral", "e22 axial", "e12 shear"]


def write_results(results: Analysis, folder: Path, images: Sequence[str] = ()) -> None:
    """Write fields, tables, summary and figures into a folder.

    ``displacement.tif`` (px), ``displacement_um.tif``, ``deviation.tif`` (px), ``strain.tif``,
    ``bubbles.csv``, ``summary.json``, for sequences also ``increments.tif``, with an identified
    sample ``stiffness.tif`` and ``stiffness_deviation.tif`` (of log E), and the figures
    ``pair``, ``displacement``, ``strain``, ``quality`` and ``stiffness`` as PNG and PDF.
    What an earlier run left there and this one does not make is removed.
    """
    for name in ("increments.tif", "deviation.tif", "stiffness.tif", "stiffness_deviation.tif"):
        (folder / name).unlink(missing_ok=True)
    for kind in ("png", "pdf"):
        (folder / f"stiffness.{kind}").unlink(missing_ok=True)
    size = componentwise(results.pixel_size, 2)
    io.write_field(folder / "displacement.tif", results.u)
    io.write_field(folder / "displacement_um.tif", results.u * size, "um")
    io.write_pages(folder / "strain.tif", results.strain, STRAIN_LABELS)
    if results.deviation is not None:
        io.write_field(folder / "deviation.tif", results.deviation)
    first = results.steps[0]
    if first.stiffness is not None:
        io.write_image(folder / "stiffness.tif", first.stiffness.E)
    if first.modulus_deviation is not None:
        io.write_image(folder / "stiffness_deviation.tif", first.modulus_deviation)
    if len(results.steps) > 1:
        increments = np.concatenate([step.estimate.u for step in results.steps])
        labels = [f"step {k}: u{i} [px]" for k in range(len(results.steps)) for i in (1, 2)]
        io.write_pages(folder / "increments.tif", increments, labels)
    tables = [step.bubbles.assign(step=k) for k, step in enumerate(results.steps)]
    io.write_table(folder / "bubbles.csv", pd.concat(tables, ignore_index=True))
    settings = Figures(pixel_size=results.pixel_size)
    for name, figure in draw(results, settings).items():
        paths = [folder / f"{name}.{kind}" for kind in ("png", "pdf")]
        figures.save(figure, paths, settings)
    io.write_json(folder / "summary.json", {"images": list(images)} | results.summary)


def draw(results: Analysis, settings: Figures | None = None) -> dict[str, Figure]:
    """The figures of a pair; of a sequence, the bubbles and standard flow of its first step."""
    settings = settings or Figures(pixel_size=results.pixel_size)
    step = results.steps[0]
    fields = {"standard flow": step.standard, "EOFM": step.estimate.u}
    drawn = {
        "pair": figures.image_pair(results.first, results.last, settings, step.bubbles),
        "displacement": figures.compare_fields(fields, settings, step.deviation),
        "strain": figures.strains(results.strain, settings),
        "quality": figures.quality(results.residual, step.inconsistency, results.share, settings),
    }
    if step.stiffness is not None:
        drawn["stiffness"] = figures.moduli(
            {"identified": step.stiffness.E}, step.modulus_deviation, settings
        )
    return drawn
