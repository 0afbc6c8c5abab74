"""The results of a pair or sequence as files and figures."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from eofm import io
from eofm.analysis import figures
from eofm.analysis.analyse import Analysis
from eofm.errors import InputError
from eofm.grid import Array, componentwise
from eofm.settings import Figures, Pair

STRAIN_LABELS = ["e11 lateral", "e22 axial", "e12 shear"]
# Kinds of files of the figures, by what `figures` says.
KINDS = {"none": (), "png": ("png",), "all": ("png", "pdf")}
FIGURES = ("pair", "displacement", "strain", "quality", "stiffness")
# What only some runs make, and all that any run makes.
SOMETIMES = (
    "increments.tif",
    "deviation.tif",
    "displacement_um.tif",
    "stiffness.tif",
    "stiffness_deviation.tif",
    *(f"{name}.{kind}" for name in FIGURES for kind in KINDS["all"]),
)
RESULTS = (
    *SOMETIMES,
    "displacement.tif",
    "strain.tif",
    "trust.tif",
    "bubbles.csv",
    "bubbles.csv.sha256",
    "provenance.json",
    "summary.json",
)


def write_results(
    results: Analysis, folder: Path, images: Sequence[str], kinds: Sequence[str]
) -> None:
    """Write fields, tables, summary and figures into a folder.

    ``displacement.tif`` (px), ``displacement_um.tif`` if the size of a pixel is known,
    ``deviation.tif`` (px), ``strain.tif``,
    ``trust.tif`` (correlation of the images after the motion), all NaN in dead zones,
    ``bubbles.csv``, ``summary.json``, ``provenance.json``, for sequences also
    ``increments.tif``, with an identified sample ``stiffness.tif`` and
    ``stiffness_deviation.tif`` (of log E), and the figures
    ``pair``, ``displacement``, ``strain``, ``quality`` and ``stiffness`` as files of some
    ``kinds``: png, pdf.
    What an earlier run left there and this one does not make is removed. All files appear
    together once the last one is complete, the summary at the very end.
    """
    with io.together():
        for name in SOMETIMES:
            io.remove(folder / name)
        _write_fields(results, folder)
        settings = Figures(pixel_size=results.pixel_size)
        for name, figure in draw(results, settings).items() if kinds else ():
            paths = [folder / f"{name}.{kind}" for kind in kinds]
            figures.save(figure, paths, settings)
        made = io.Origin.current() or io.Origin("analyse", {})
        io.write_json(folder / "provenance.json", made.record() | {"run": made.run()})
        summary = {"images": list(images)} | results.summary | {"provenance": made.record()}
        io.write_json(folder / "summary.json", summary)


def check_results(folder: Path, pair: Pair) -> None:
    """Refuse a folder that cannot hold results, or in which they would replace what is read.

    Raises
    ------
    InputError
        In one line that names the folder or file.
    """
    place = folder.resolve()
    if place.exists() and not place.is_dir():
        raise InputError(f"{folder}: is no folder; name one")
    texts = [value for value in pair.model_dump().values() if isinstance(value, str)]
    for word in (word for text in texts for word in (text, *text.split())):
        file = Path(os.path.realpath(word.partition("#")[0].replace("\0", "")))
        if file.parent == place and file.name in RESULTS and file.is_file():
            raise InputError(f"{word}: is read, and results would replace it; name another folder")
    for name in RESULTS if place.is_dir() else ():
        io.check_place(folder / name)


def _write_fields(results: Analysis, folder: Path) -> None:
    """Write all fields and the table of bubbles."""
    sides = results.pixel_size if results.summary["pixel_size_from"] else None

    def seen(values: Array) -> Array:
        return np.where(results.dead, np.nan, values)

    io.write_field(folder / "displacement.tif", seen(results.u), sides=sides)
    if sides is not None:
        um = seen(results.u * componentwise(sides, 2))
        io.write_field(folder / "displacement_um.tif", um, "um", sides)
    io.write_pages(folder / "strain.tif", seen(results.strain), STRAIN_LABELS, sides)
    io.write_image(folder / "trust.tif", seen(results.trust.map), sides)
    if results.deviation is not None:
        deviation = seen(results.deviation)
        io.write_field(folder / "deviation.tif", deviation, sides=sides, of="deviation")
    first = results.steps[0]
    if first.stiffness is not None and not first.stiffness.refused:
        io.write_image(folder / "stiffness.tif", seen(first.stiffness.E), sides)
    if first.modulus_deviation is not None and np.isfinite(first.modulus_deviation).all():
        io.write_image(folder / "stiffness_deviation.tif", seen(first.modulus_deviation), sides)
    if len(results.steps) > 1:
        increments = seen(np.concatenate([step.estimate.u for step in results.steps]))
        labels = [f"step {k}: u{i} [px]" for k in range(len(results.steps)) for i in (1, 2)]
        io.write_pages(folder / "increments.tif", increments, labels, sides)
    tables = [step.bubbles.assign(step=k) for k, step in enumerate(results.steps)]
    io.write_table(folder / "bubbles.csv", pd.concat(tables, ignore_index=True))


def draw(results: Analysis, settings: Figures | None = None) -> dict[str, Figure]:
    """The figures of a pair or sequence; of a sequence, the bubbles of its first step."""
    settings = settings or Figures(pixel_size=results.pixel_size)
    step, count, trust = results.steps[0], len(results.steps), results.trust
    fields = {"standard flow": step.standard, "EOFM": results.u}
    if count > 1:
        fields = {f"EOFM, sum of {count} steps": results.u}
    quality = {
        "residual $I_2(x + u) - I_1$": results.residual,
        "forward-backward error": step.inconsistency,
        f"correlation after the motion: {trust.verdict}": trust.map,
        "share of the images in the estimate": results.share,
    }
    drawn = {
        "pair": figures.image_pair(results.first, results.last, settings, step.bubbles),
        "displacement": figures.compare_fields(fields, settings, results.deviation),
        "strain": figures.strains(results.strain, settings),
        "quality": figures.quality(
            {name: np.where(results.dead, np.nan, values) for name, values in quality.items()},
            settings,
        ),
    }
    if step.stiffness is not None and not step.stiffness.refused:
        drawn["stiffness"] = figures.moduli(
            {"identified": step.stiffness.E}, step.modulus_deviation, settings
        )
    return drawn
