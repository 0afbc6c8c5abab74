"""The results of a pair or sequence as files and figures."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from eofm import io
from eofm.analysis.analyse import Analysis
from eofm.analysis.page import page, shares
from eofm.analysis.tensors import invariants, labels
from eofm.errors import InputError
from eofm.grid import Array, componentwise
from eofm.settings import Figures, Pair

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    "images.tif",
    "results.vti",
    "strain.tif",
    "strain_invariants.tif",
    "trust.tif",
    "bubbles.csv",
    "bubbles.csv.sha256",
    "provenance.json",
    "report.html",
    "summary.json",
)


def write_results(
    results: Analysis, folder: Path, images: Sequence[str], kinds: Sequence[str]
) -> None:
    """Write fields, tables, summary and figures into a folder.

    ``images.tif`` (the first and the last frame), ``displacement.tif`` (px),
    ``displacement_um.tif`` if the size of a pixel is known, ``deviation.tif`` (px), ``strain.tif``,
    ``strain_invariants.tif`` (principal strains, change of volume, maximum shear), ``trust.tif``
    (correlation of the images after the motion), all but the images NaN in dead zones,
    ``results.vti`` (the same for ParaView), ``bubbles.csv``, ``report.html`` (one page that
    explains them), ``summary.json``, ``provenance.json``, for sequences also ``increments.tif``
    (the displacement of each step, px; steps count from 1), with an identified sample
    ``stiffness.tif`` and ``stiffness_deviation.tif`` (of log E), and the figures ``pair``,
    ``displacement``, ``strain``, ``quality`` and ``stiffness`` as files of some ``kinds``: png,
    pdf.
    What an earlier run left there and this one does not make is removed. All files appear
    together once the last one is complete, the summary at the very end.
    """
    with io.together():
        for name in SOMETIMES:
            io.remove(folder / name)
        _write_fields(results, folder)
        _write_vti(results, folder)
        if kinds:
            _write_figures(results, folder, kinds)
        made = io.Origin.current() or io.Origin("analyse", {})
        by = f"Made by eofm {made.record()['eofm']}, step {made.step}."
        text = page(results, folder.resolve().name, images, by)
        with io.replacing(folder / "report.html") as temporary:
            temporary.write_text(text, encoding="utf-8")
        io.write_json(folder / "provenance.json", made.record() | {"run": made.run()})
        summary = {"images": list(images)} | results.summary | {"provenance": made.record()}
        io.write_json(folder / "summary.json", summary)


def _write_vti(results: Analysis, folder: Path) -> None:
    """All fields on the first frame, lengths in the unit of its sides, which warping asks for."""
    n = results.first.ndim
    unit = "um" if results.summary["pixel_size_from"] else "px"
    side = componentwise(results.pixel_size if unit == "um" else (1.0,) * n, n)
    arrays = {"first frame": results.first, f"displacement [{unit}]": results.u * side}
    if results.deviation is not None:
        arrays[f"standard deviation [{unit}]"] = results.deviation * side
    arrays["strain"] = results.strain
    arrays |= invariants(results.strain, results.summary["strain_measure"])
    arrays |= {"match of the images": results.trust.map, "share of the images": shares(results)}
    first = results.steps[0].stiffness
    if first is not None and not first.refused:
        arrays["relative modulus"] = first.E
    seen = {name: np.where(results.dead, np.nan, f) for name, f in arrays.items()}
    seen["first frame"] = results.first
    components = {"strain": labels(n)}
    io.write_vti(folder / "results.vti", seen, results.pixel_size, components)


def _write_figures(results: Analysis, folder: Path, kinds: Sequence[str]) -> None:
    # Its import takes as long as a small sample.
    from eofm.analysis import figures

    settings = figure_settings(results)
    for name, figure in draw(results, settings).items():
        figures.save(figure, [folder / f"{name}.{kind}" for kind in kinds], settings)


def check_results(folder: Path, pair: Pair) -> None:
    """Refuse a folder that cannot hold results, or where they would replace what is read.

    Raises
    ------
    InputError
        In one line that names the folder or file.
    """
    place = folder.resolve()
    if place.exists() and not place.is_dir():
        raise InputError(f"{folder}: is no folder; name one")
    above = next(parent for parent in place.parents if parent.exists())
    if not place.exists() and not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
        raise InputError(f"{folder}: nothing can be written to {above}; name another folder")
    texts = [value for value in pair.model_dump().values() if isinstance(value, str)]
    for word in (word for text in texts for word in (text, *text.split())):
        file = Path(os.path.realpath(word.partition("#")[0].replace("\0", "")))
        if file.parent == place and file.name in RESULTS and file.is_file():
            raise InputError(f"{word}: is read, and results would replace it; name another folder")
    for name in RESULTS if place.is_dir() else ():
        io.check_place(folder / name)


def _write_fields(results: Analysis, folder: Path) -> None:
    """Write all fields and the table of bubbles."""
    n = results.first.ndim
    sides = results.pixel_size if results.summary["pixel_size_from"] else None

    def seen(values: Array) -> Array:
        return np.where(results.dead, np.nan, values)

    io.write_field(folder / "displacement.tif", seen(results.u), sides=sides)
    if sides is not None:
        um = seen(results.u * componentwise(sides, n))
        io.write_field(folder / "displacement_um.tif", um, "um", sides)
    frames = np.stack([results.first, results.last])
    io.write_pages(folder / "images.tif", frames, ["first", "last"], sides)
    io.write_pages(folder / "strain.tif", seen(results.strain), labels(n), sides)
    derived = invariants(results.strain, results.summary["strain_measure"])
    values = seen(np.stack(list(derived.values())))
    io.write_pages(folder / "strain_invariants.tif", values, list(derived), sides)
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
        count = len(results.steps)
        names = [f"step {k + 1}: u{i + 1} [px]" for k in range(count) for i in range(n)]
        io.write_pages(folder / "increments.tif", increments, names, sides)
    tables = [step.bubbles.assign(step=k) for k, step in enumerate(results.steps, 1)]
    io.write_table(folder / "bubbles.csv", pd.concat(tables, ignore_index=True))


def draw(results: Analysis, settings: Figures | None = None) -> "dict[str, Figure]":
    """The figures of a pair or sequence; of a sequence, the bubbles of its first step."""
    from eofm.analysis import figures

    settings = settings or figure_settings(results)
    step, count, trust = results.steps[0], len(results.steps), results.trust
    of_first = "" if count == 1 else ", first step"
    fields = {"EOFM": results.u}
    if step.standard is not None:
        fields = {"standard flow": step.standard} | fields
    titles = ("before compression", "after compression")
    if count > 1:
        fields = {f"EOFM, sum of {count} steps": results.u}
        titles = (f"first frame{of_first}", f"last of {count + 1} frames")
    quality = {
        "residual $I_2(x + u) - I_1$": results.residual,
        f"forward-backward error{of_first}": step.inconsistency,
        f"correlation after the motion: {trust.verdict}": trust.map,
        "what decides the estimate": shares(results),
    }
    drawn = {
        "pair": figures.image_pair(results.first, results.last, settings, step.bubbles, titles),
        "displacement": figures.compare_fields(fields, settings, results.deviation),
        "strain": figures.strains(results.strain, settings, results.summary["strain_measure"]),
        "quality": figures.quality(
            {name: np.where(results.dead, np.nan, values) for name, values in quality.items()},
            settings,
        ),
    }
    if step.stiffness is not None and not step.stiffness.refused:
        drawn["stiffness"] = figures.moduli(
            {f"identified{of_first}": step.stiffness.E}, step.modulus_deviation, settings
        )
    return drawn


def figure_settings(results: Analysis) -> Figures:
    """Figures in um where the size of a pixel was said."""
    unit = "um" if results.summary["pixel_size_from"] else "px"
    return Figures(pixel_size=results.pixel_size, unit=unit)
