"""Figures of images and displacement fields, as one would put them into a paper.

Positions, displacements and their errors have one unit; depth grows downwards. The colour maps
are safe for colour-blind readers, and level lines carry the values in print. Of volumes, panels
show three sections, see `eofm.analysis.sections`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eofm.analysis.findings import ASTRAY, SHORT
from eofm.analysis.panels import (
    SHARE,
    Look,
    arrows,
    level_lines,
    name_axes,
    panels,
    scale,
    show,
    unit_name,
)
from eofm.analysis.sections import Sections
from eofm.analysis.tensors import pairs
from eofm.grid import Array
from eofm.io import replacing
from eofm.settings import Figures

STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 9,
    "pdf.fonttype": 42,
    "image.interpolation": "nearest",
}
MAPS = ("RdBu_r", "viridis", "RdBu_r")
NAMES = ("lateral", "axial", "elevational")


def image_pair(
    I1: Array,
    I2: Array,
    settings: Figures = Figures(),
    bubbles: pd.DataFrame | None = None,
    titles: tuple[str, str] = ("before compression", "after compression"),
) -> Figure:
    """Images before and after compression in one grey scale, the brightest pixels cut off.

    With ``bubbles``, arrows on the image before show their motion, as in Figure 1.
    """
    low, high = np.percentile([I1, I2], [0, 99.9])
    look = Look("gray", (float(low), float(high)))
    with mpl.rc_context(STYLE):
        figure, axes = panels(1, 2, I1.shape, settings)
        for axis, I, title in zip(axes[0], (I1, I2), titles, strict=True):
            show(axis, I, title, look, settings)
        if bubbles is not None and I1.ndim == 2:
            arrows(axes[0, 0], bubbles, I1.shape, settings)
        name_axes(axes, settings)
    return figure


def compare_fields(
    fields: Mapping[str, Array], settings: Figures = Figures(), deviation: Array | None = None
) -> Figure:
    """Several fields by the names of their methods: u1 above u2, one scale in a row.

    With the standard ``deviation`` of the last one beside it.
    """
    shape, columns = next(iter(fields.values())).shape[1:], len(fields) + (deviation is not None)
    with mpl.rc_context(STYLE):
        figure, axes = panels(len(shape), columns, shape, settings)
        for i in range(len(shape)):
            limits = _limits(np.stack([u[i] for u in fields.values()]), i)
            for axis, (name, u) in zip(axes[i], fields.items(), strict=False):
                _draw(axis, u[i], f"{name}: $u_{i + 1}$", MAPS[i], i, limits, settings)
            if deviation is not None:
                _draw_deviation(axes[i, -1], deviation[i], i, settings)
        name_axes(axes, settings)
    return figure


def compare_errors(
    fields: Mapping[str, Array], truth: Array, settings: Figures = Figures()
) -> Figure:
    """Absolute errors of several fields: u1 above u2, one scale in a row.

    Errors are rougher than fields, so they get half as many level lines.
    """
    settings = settings.changed(levels=max(settings.levels // 2, 2))
    with mpl.rc_context(STYLE):
        figure, axes = panels(len(truth), len(fields), truth.shape[1:], settings)
        for i in range(len(truth)):
            errors = {name: np.abs(u[i] - truth[i]) for name, u in fields.items()}
            limits = (0.0, max(float(error.max()) for error in errors.values()) or 1.0)
            for axis, (name, error) in zip(axes[i], errors.items(), strict=True):
                title = f"{name}: error of $u_{i + 1}$, {_at_most(error, i, settings)}"
                _draw(axis, error, title, "magma_r", i, limits, settings)
        name_axes(axes, settings)
    return figure


def field(u: Array, settings: Figures = Figures()) -> Figure:
    """The components of a displacement field side by side."""
    with mpl.rc_context(STYLE):
        figure, axes = panels(1, len(u), u.shape[1:], settings)
        for i, axis in enumerate(axes[0]):
            draw_component(axis, u[i], i, _limits(u[i], i), settings)
        name_axes(axes, settings)
    return figure


def field_and_error(
    estimate: Array,
    truth: Array,
    largest: float,
    settings: Figures = Figures(),
    deviation: Array | None = None,
) -> Figure:
    """An estimated field (left), its absolute error, and its standard deviation if known.

    u1 stands above u2. The estimate is drawn on the scale of the true field, the error from
    0 to ``largest`` px, so that figures of several estimates compare.
    """
    n = len(truth)
    with mpl.rc_context(STYLE):
        figure, axes = panels(n, 2 if deviation is None else 3, truth.shape[1:], settings)
        for i in range(n):
            draw_component(axes[i, 0], estimate[i], i, _limits(truth[i], i), settings)
            error = np.abs(estimate[i] - truth[i])
            title = f"absolute error of $u_{i + 1}$, {_at_most(error, i, settings)}"
            _draw(axes[i, 1], error, title, "magma_r", i, (0, largest), settings)
            if deviation is not None:
                _draw_deviation(axes[i, 2], deviation[i], i, settings)
        name_axes(axes, settings)
    return figure


def strains(e: Array, settings: Figures, measure: str = "small") -> Figure:
    """Normal and shear strains, in percent, on one scale, which leaves out 1 % at either end."""
    n = e.ndim - 1
    of = "" if measure == "small" else f" ({measure})"
    largest = max(*(float(np.nanpercentile(np.abs(100 * part), 99)) for part in e), 1e-6)
    look = Look("RdBu_r", (-largest, largest), "%")
    with mpl.rc_context(STYLE):
        figure, axes = panels(len(e) // 3, 3, e.shape[1:], settings)
        for axis, values, (i, j) in zip(axes.flat, 100 * e, pairs(n), strict=True):
            name = f"{NAMES[i]} strain" if i == j else "shear strain"
            show(axis, values, f"{name} $e_{{{i + 1}{j + 1}}}${of}", look, settings)
        name_axes(axes, settings)
    return figure


def quality(maps: Mapping[str, Array], settings: Figures) -> Figure:
    """Four maps by their names.

    What is left after the motion, the forward-backward error in px, the correlation of the
    images, and the share that they have in the estimate.
    """
    residual, inconsistency, *_ = maps.values()
    unit = _mean_side(settings, residual.ndim)
    largest = max(float(np.nanpercentile(np.abs(residual), 99)), 1e-6)
    worst = max(float(np.nanpercentile(inconsistency, 99)), ASTRAY)
    looks = [
        Look("PuOr", (-largest, largest)),
        Look("magma_r", (0, worst * unit), unit_name(settings)),
        Look("cividis", (0, 1)),
        SHARE,
    ]
    factors = (1, unit, 1, 1)
    with mpl.rc_context(STYLE):
        figure, axes = panels(2, 2, residual.shape, settings)
        shown = zip(axes.flat, maps.items(), factors, looks, strict=True)
        for axis, (title, values), factor, look in shown:
            show(axis, factor * values, title, look, settings)
        name_axes(axes, settings)
    return figure


def sections(
    rows: Sequence[Sequence[tuple[str, Sections, Look]]], settings: Figures = Figures()
) -> Figure:
    """Rows of sections of volumes, each with its title and its look."""
    shape = rows[0][0][1].shape
    with mpl.rc_context(STYLE):
        figure, axes = panels(len(rows), max(map(len, rows)), shape, settings)
        for (i, j), axis in np.ndenumerate(axes):
            title, values, look = rows[i][j]
            show(axis, values, title, look, settings)
        name_axes(axes, settings)
    return figure


def moduli(
    maps: Mapping[str, Array],
    deviation: Array | None,
    settings: Figures,
    outline: Array | None = None,
) -> Figure:
    """Relative moduli by their names on one logarithmic scale, and the deviation of ln E.

    Black lines show where ``outline``, a true modulus, passes the geometric mean of its
    extremes.
    """
    shape = next(iter(maps.values())).shape
    largest = max(np.abs(np.log10(np.stack(list(maps.values())))).max(), 0.05)
    x1, x2 = (np.arange(n) * p for n, p in zip(shape[::-1], scale(settings, 2), strict=True))
    look = Look("PuOr_r", (-largest, largest))
    with mpl.rc_context(STYLE):
        figure, axes = panels(1, len(maps) + (deviation is not None), shape, settings)
        for axis, (name, E) in zip(axes[0], maps.items(), strict=False):
            show(axis, np.log10(E), f"$\\log_{{10}} E / E_{{bg}}$, {name}", look, settings)
            if outline is not None:
                for extreme in {outline.min(), outline.max()} - {1.0}:
                    level = [np.sqrt(extreme)]
                    axis.contour(x1, x2, outline, level, colors="black", linewidths=0.5)
        if deviation is not None:
            bar = Look("magma_r", (0, float(deviation.max())))
            show(axes[0, -1], deviation, "standard deviation of $\\ln E$", bar, settings)
        name_axes(axes, settings)
    return figure


def draw_component(
    axis: Axes, values: Array, i: int, limits: tuple[float, float], settings: Figures
) -> None:
    """Draw component ``i`` of a field, and its ``limits``, px, with level lines."""
    title = f"{NAMES[i]} displacement $u_{i + 1}$"
    _draw(axis, values, title, MAPS[i], i, limits, settings)


def save(figure: Figure, paths: Sequence[Path], settings: Figures = Figures()) -> None:
    """Write a figure to files of the kinds that their names end in, free of dates."""
    for path in paths:
        more: Any = {"metadata": {"CreationDate": None}} if path.suffix == ".pdf" else {}
        if path.suffix == ".png":
            more = {"pil_kwargs": {"compress_level": 4}}
        with replacing(path) as temporary, mpl.rc_context(STYLE):
            figure.savefig(temporary, dpi=settings.dpi, **more)


def _limits(values: Array, i: int) -> tuple[float, float]:
    """Symmetric about zero for the lateral component, the range for the axial one."""
    if i != 1:
        largest = float(np.abs(values).max()) or 1.0
        return -largest, largest
    low, high = float(values.min()), float(values.max())
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _draw(
    axis: Axes,
    values: Array,
    title: str,
    colours: str,
    i: int,
    limits: tuple[float, float],
    settings: Figures,
) -> None:
    """Component ``i`` of what is given in px, with level lines."""
    factor = scale(settings, values.ndim)[i]
    limits = factor * limits[0], factor * limits[1]
    show(axis, factor * values, title, Look(colours, limits, unit_name(settings)), settings)
    level_lines(axis, factor * values, limits, settings, settings.levels)


def _draw_deviation(axis: Axes, deviation: Array, i: int, settings: Figures) -> None:
    factor = scale(settings, deviation.ndim)[i]
    largest = factor * max(float(np.percentile(deviation, 99.5)), SHORT)
    look = Look("magma_r", (0, largest), unit_name(settings))
    show(axis, factor * deviation, f"standard deviation of $u_{i + 1}$", look, settings)


def _at_most(error: Array, i: int, settings: Figures) -> str:
    return f"≤ {error.max() * scale(settings, error.ndim)[i]:.2f}"


def _mean_side(settings: Figures, ndim: int) -> float:
    """Side of a pixel in the unit of the figure where no direction is told."""
    return float(np.prod(scale(settings, ndim)) ** (1 / ndim))
