"""Figures of images and displacement fields, as one would put them into a paper.

Positions are in um, displacements in px; depth grows downwards. The colour maps are
safe for colour-blind readers, and level lines carry the values in print.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from eofm.grid import Array
from eofm.io import replacing
from eofm.settings import Figures

STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 9,
    "contour.linewidth": 0.5,
    "pdf.fonttype": 42,
    "image.interpolation": "nearest",
}
MAPS = ("RdBu_r", "viridis")
COMPONENTS = ("u_1", "u_2")
NAMES = ("lateral", "axial")
WIDTH = 3.4  # of one panel, inches
ARROWS = 250


def image_pair(
    I1: Array, I2: Array, settings: Figures = Figures(), bubbles: pd.DataFrame | None = None
) -> Figure:
    """Images before and after compression in one grey scale, the brightest pixels cut off.

    With ``bubbles``, red arrows show their motion, as in Figure 1.
    """
    low, high = np.percentile([I1, I2], [0, 99.9])
    with mpl.rc_context(STYLE):
        figure, axes = _panels(1, 2, I1.shape, settings)
        for axis, I, title in zip(axes[0], (I1, I2), ("before", "after"), strict=True):
            shown = axis.imshow(I, "gray", vmin=low, vmax=high, extent=_extent(I.shape, settings))
            axis.set_title(f"{title} compression")
            if bubbles is not None:
                _arrows(axis, bubbles, I.shape[1] * settings.pixel_size[0], settings)
        _colour_bar(axes[0, 1], shown, "intensity")
        _label(axes)
    return figure


def compare_fields(
    fields: Mapping[str, Array], settings: Figures = Figures(), deviation: Array | None = None
) -> Figure:
    """Several fields by the names of their methods: u1 above u2, one scale in a row.

    With the standard ``deviation`` of the last one beside it.
    """
    shape, columns = next(iter(fields.values())).shape[1:], len(fields) + (deviation is not None)
    with mpl.rc_context(STYLE):
        figure, axes = _panels(2, columns, shape, settings)
        for i in (0, 1):
            limits = _limits(np.stack([u[i] for u in fields.values()]), i)
            for axis, (name, u) in zip(axes[i], fields.items(), strict=False):
                _draw(axis, u[i], f"{name}: ${COMPONENTS[i]}$", MAPS[i], limits, settings)
            if deviation is not None:
                _draw_deviation(axes[i, -1], deviation[i], i, settings)
        _label(axes)
    return figure


def compare_errors(
    fields: Mapping[str, Array], truth: Array, settings: Figures = Figures()
) -> Figure:
    """Absolute errors of several fields: u1 above u2, one scale in a row.

    Errors are rougher than fields, so they get half as many level lines.
    """
    settings = settings.changed(levels=max(settings.levels // 2, 2))
    with mpl.rc_context(STYLE):
        figure, axes = _panels(2, len(fields), truth.shape[1:], settings)
        for i in (0, 1):
            errors = {name: np.abs(u[i] - truth[i]) for name, u in fields.items()}
            limits = (0.0, max(float(error.max()) for error in errors.values()) or 1.0)
            for axis, (name, error) in zip(axes[i], errors.items(), strict=True):
                title = f"{name}: error of ${COMPONENTS[i]}$ ≤ {error.max():.2f} px"
                _draw(axis, error, title, "magma_r", limits, settings)
        _label(axes)
    return figure


def field(u: Array, settings: Figures = Figures()) -> Figure:
    """Both components of a displacement field side by side."""
    with mpl.rc_context(STYLE):
        figure, axes = _panels(1, 2, u.shape[1:], settings)
        for i in (0, 1):
            draw_component(axes[0, i], u[i], i, _limits(u[i], i), settings)
        _label(axes)
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
    with mpl.rc_context(STYLE):
        figure, axes = _panels(2, 2 if deviation is None else 3, truth.shape[1:], settings)
        for i in (0, 1):
            draw_component(axes[i, 0], estimate[i], i, _limits(truth[i], i), settings)
            error = np.abs(estimate[i] - truth[i])
            title = f"absolute error of ${COMPONENTS[i]}$, at most {error.max():.2f} px"
            _draw(axes[i, 1], error, title, "magma_r", (0, largest), settings)
            if deviation is not None:
                _draw_deviation(axes[i, 2], deviation[i], i, settings)
        _label(axes)
    return figure


def strains(e: Array, settings: Figures) -> Figure:
    """Lateral, axial and shear strain, in percent; the range leaves out 1 % at either end."""
    names = ("lateral strain $e_{11}$", "axial strain $e_{22}$", "shear strain $e_{12}$")
    with mpl.rc_context(STYLE):
        figure, axes = _panels(1, 3, e.shape[1:], settings)
        for axis, values, title in zip(axes[0], 100 * e, names, strict=True):
            largest = max(float(np.percentile(np.abs(values), 99)), 1e-6)
            _show(axis, values, title, "RdBu_r", (-largest, largest), "%", settings)
        _label(axes)
    return figure


def quality(maps: Mapping[str, Array], settings: Figures) -> Figure:
    """Four maps by their names.

    What is left after the motion, the forward-backward error in px, the correlation of the
    images, and the share that they have in the estimate, the last two from 0 to 1.
    """
    residual, inconsistency, *_ = maps.values()
    largest = max(float(np.nanpercentile(np.abs(residual), 99)), 1e-6)
    worst = max(float(np.nanpercentile(inconsistency, 99)), 1e-3)
    looks: list[tuple[str, tuple[float, float], str]] = [
        ("PuOr", (-largest, largest), ""),
        ("magma_r", (0, worst), "px"),
        ("cividis", (0, 1), ""),
        ("cividis", (0, 1), ""),
    ]
    with mpl.rc_context(STYLE):
        figure, axes = _panels(2, 2, residual.shape, settings)
        for axis, (title, values), look in zip(axes.flat, maps.items(), looks, strict=True):
            colours, limits, unit = look
            _show(axis, values, title, colours, limits, unit, settings)
        _label(axes)
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
    x1, x2 = (np.arange(n) * p for n, p in zip(shape[::-1], settings.pixel_size, strict=True))
    with mpl.rc_context(STYLE):
        figure, axes = _panels(1, len(maps) + (deviation is not None), shape, settings)
        for axis, (name, E) in zip(axes[0], maps.items(), strict=False):
            title = f"$\\log_{{10}} E / E_{{bg}}$, {name}"
            _show(axis, np.log10(E), title, "PuOr_r", (-largest, largest), "", settings)
            if outline is not None:
                for extreme in {outline.min(), outline.max()} - {1.0}:
                    axis.contour(x1, x2, outline, [np.sqrt(extreme)], colors="black")
        if deviation is not None:
            top, title = float(deviation.max()), "standard deviation of $\\ln E$"
            _show(axes[0, -1], deviation, title, "magma_r", (0, top), "", settings)
        _label(axes)
    return figure


def draw_component(
    axis: Axes, values: Array, i: int, limits: tuple[float, float], settings: Figures
) -> None:
    """Draw component ``i`` of a field with level lines."""
    _draw(axis, values, f"{NAMES[i]} displacement ${COMPONENTS[i]}$", MAPS[i], limits, settings)


def save(figure: Figure, paths: Sequence[Path], settings: Figures = Figures()) -> None:
    """Write a figure to files of the kinds that their names end in, free of dates.

    Its layout is that of the first file, from then on.
    """
    for path in paths:
        metadata = {"CreationDate": None} if path.suffix == ".pdf" else {}
        with replacing(path) as temporary, mpl.rc_context(STYLE):
            figure.savefig(temporary, dpi=settings.dpi, metadata=metadata)
        figure.set_layout_engine("none")


def _panels(
    rows: int, columns: int, shape: tuple[int, ...], settings: Figures
) -> tuple[Figure, NDArray]:
    p1, p2 = settings.pixel_size
    aspect = shape[0] * p2 / (shape[1] * p1)
    height = WIDTH * 0.74 * min(max(aspect, 0.3), 1.5) + 0.55
    # Panels of a deep image are narrower instead of taller, as far as titles allow.
    width = WIDTH * max(min(1.5 / aspect, 1.0), 0.6)
    figure = Figure((columns * width, rows * height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)


def _extent(shape: tuple[int, ...], settings: Figures) -> tuple[float, float, float, float]:
    height, width = shape
    p1, p2 = settings.pixel_size
    return (-p1 / 2, (width - 0.5) * p1, (height - 0.5) * p2, -p2 / 2)


def _limits(values: Array, i: int) -> tuple[float, float]:
    """Symmetric about zero for the lateral component, the range for the axial one."""
    if i == 0:
        largest = float(np.abs(values).max()) or 1.0
        return -largest, largest
    low, high = float(values.min()), float(values.max())
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _draw(
    axis: Axes,
    values: Array,
    title: str,
    colours: str,
    limits: tuple[float, float],
    settings: Figures,
) -> None:
    extent = _extent(values.shape, settings)
    shown = axis.imshow(values, colours, vmin=limits[0], vmax=limits[1], extent=extent)
    axis.set_title(title)
    _colour_bar(axis, shown, "px")
    levels = MaxNLocator(settings.levels).tick_values(*limits)
    # Edges that are held would be level lines themselves.
    inner, margin = values[1:-1, 1:-1], 0.02 * (limits[1] - limits[0])
    low, high = max(limits[0] + margin, inner.min()), min(limits[1] - margin, inner.max())
    levels = levels[(levels > low) & (levels < high)]
    if levels.size:
        sides = zip(values.shape[::-1], settings.pixel_size, strict=True)
        x1, x2 = (np.arange(1, n - 1) * p for n, p in sides)
        lines = axis.contour(x1, x2, inner, levels, colors="black", linestyles="solid")
        axis.clabel(lines, fontsize=6, fmt="%g")


def _draw_deviation(axis: Axes, deviation: Array, i: int, settings: Figures) -> None:
    largest = max(float(np.percentile(deviation, 99.5)), 1e-6)
    title = f"standard deviation of ${COMPONENTS[i]}$"
    _show(axis, deviation, title, "magma_r", (0, largest), "px", settings)


def _show(
    axis: Axes,
    values: Array,
    title: str,
    colours: str,
    limits: tuple[float, float],
    unit: str,
    settings: Figures,
) -> None:
    """An image with its colour bar; grey where there is no value."""
    extent = _extent(values.shape, settings)
    shown = axis.imshow(values, colours, vmin=limits[0], vmax=limits[1], extent=extent)
    axis.set_facecolor("0.7")
    axis.set_title(title)
    _colour_bar(axis, shown, unit)


def _arrows(axis: Axes, bubbles: pd.DataFrame, width: float, settings: Figures) -> None:
    """Arrows of the motion, longer than true where that would be too short to see.

    More than ``ARROWS`` would hide the image, so some are left out then.
    """
    shown = bubbles.iloc[:: -(-len(bubbles) // ARROWS)]
    p = np.array([*settings.pixel_size, *settings.pixel_size])
    x1, x2, u1, u2 = p[:, None] * shown[["x1", "x2", "u1", "u2"]].to_numpy(float).T
    longest = max(float(np.hypot(u1, u2).max()), 1e-9)
    factor = max((f for f in (1, 2, 5, 10, 20, 50) if f * longest <= 0.05 * width), default=1)
    style: Any = {"color": "red", "angles": "xy", "scale_units": "xy", "scale": 1 / factor}
    axis.quiver(x1, x2, u1, u2, width=0.0025, headwidth=3.5, headlength=3.5, **style)
    if factor > 1:
        axis.set_title(f"{axis.get_title()}, arrows x {factor}")


def _colour_bar(axis: Axes, shown: AxesImage, label: str) -> None:
    """A colour bar as high as the axes."""
    place = axis.inset_axes((1.02, 0, 0.03, 1))
    axis.figure.colorbar(shown, cax=place, label=label, ticks=MaxNLocator(6))


def _label(axes: NDArray) -> None:
    for axis in axes[-1]:
        axis.set_xlabel("lateral position [µm]")
    for axis in axes[:, 0]:
        axis.set_ylabel("axial position [µm]")
