"""Panels of figures: an image with its colour bar, level lines and arrows, at fixed places.

Places are computed from the sizes of the letters instead of measured: a layout that measures
draws every figure several times.
"""

from dataclasses import dataclass
from typing import Any

import contourpy
import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy import ndimage

from eofm.analysis.arrows import enlarged, motions
from eofm.analysis.sections import Sections, picture, side
from eofm.grid import Array
from eofm.settings import Figures

# Inches: width of an image, and room on its sides, for a title, and for labels of the axes.
WIDTH, LEFT, TITLE, BOTTOM, BETWEEN = 2.5, 0.6, 0.3, 0.42, 0.1
BAR, BAR_GAP, BAR_LABELS = 0.09, 0.06, 0.52
# Width of a letter of a title in parts of its size, and the size of titles, points.
LETTER, TITLE_SIZE = 0.52, 9
ARROWS = 150
# Level lines shorter than this part of the picture say nothing, nor do those that wind so often,
# nor a level in so many pieces.
SHORTEST, WINDING, PIECES = 0.15, 4.0, 8
# What decides the estimate, from the share of the images in it.
DECIDES = ("filled in", "mixed", "images")
SHARES = (0.0, 0.1, 0.5, 1.0)


@dataclass(frozen=True)
class Look:
    """How values are shown: colours, their range, and the unit."""

    colours: str
    limits: tuple[float, float]
    unit: str = ""


SHARE = Look("share", (0, 1))


def scale(settings: Figures, ndim: int) -> tuple[float, ...]:
    """Sides of a pixel in the unit of the figure."""
    return settings.sides(ndim) if settings.unit == "um" else (1.0,) * ndim


def unit_name(settings: Figures) -> str:
    """The unit of lengths as it is written."""
    return "µm" if settings.unit == "um" else "px"


def panels(
    rows: int, columns: int, shape: tuple[int, ...], settings: Figures
) -> tuple[Figure, NDArray]:
    """A figure with rows and columns of axes for images, or volumes, of a shape."""
    width, height = _lengths(shape, settings)
    aspect = height / width
    # Panels of a deep image are narrower instead of taller, as far as titles allow.
    wide = WIDTH * max(min(1.5 / aspect, 1.0), 0.6)
    high = wide * min(max(aspect, 0.25), 3.0)
    across, down = BAR_GAP + BAR + BAR_LABELS, TITLE + BETWEEN
    size = LEFT + columns * (wide + across), rows * (high + down) - BETWEEN + BOTTOM
    figure = Figure(size)
    figure.set_layout_engine("none")
    axes = np.empty((rows, columns), dtype=object)
    for i, j in np.ndindex(rows, columns):
        x, y = LEFT + j * (wide + across), size[1] - (i + 1) * (high + down) + BETWEEN
        axes[i, j] = figure.add_axes(
            (x / size[0], y / size[1], wide / size[0], high / size[1]), aspect="auto"
        )
    return figure, axes


def show(axis: Axes, values: Array | Sections, title: str, look: Look, settings: Figures) -> None:
    """Draw values with a title and a colour bar; grey where there is none."""
    ndim = values.ndim
    shown = picture(values, settings.sides(ndim))
    colours, norm = _colours(look)
    axis.imshow(
        shown, colours, norm=norm, extent=_extent(shown.shape, ndim, settings), aspect="auto"
    )
    axis.set_facecolor("0.75" if ndim == 2 else "white")
    _title(axis, f"{title} [{look.unit}]" if look.unit else title)
    _colour_bar(axis, colours, norm, look)
    if ndim == 3:
        _name_sections(axis, values.shape, settings)


def level_lines(
    axis: Axes, values: Array, limits: tuple[float, float], settings: Figures, count: int
) -> None:
    """Draw level lines of an image with at most one label each, none of which hide another."""
    if values.ndim == 3:
        return
    levels = np.asarray(MaxNLocator(count).tick_values(*limits))
    # Edges that are held would be level lines themselves, and single pixels make none.
    inner = ndimage.gaussian_filter(values, 0.01 * max(values.shape))[1:-1, 1:-1]
    margin = 0.02 * (limits[1] - limits[0])
    low, high = max(limits[0] + margin, inner.min()), min(limits[1] - margin, inner.max())
    p = scale(settings, 2)
    x1, x2 = (np.arange(1, n - 1) * s for n, s in zip(values.shape[::-1], p, strict=True))
    lines = contourpy.contour_generator(x1, x2, inner)
    size = np.array(values.shape[::-1]) * p
    placed: list[Array] = []
    for level in levels[(levels > low) & (levels < high)]:
        found: Any = lines.lines(float(level))
        kept = [line for line in found if _says_something(line / size)]
        if kept and len(found) <= PIECES:
            axis.add_collection(LineCollection(kept, colors="black", linewidths=0.5))
            _place_label(axis, max(kept, key=len), f"{level:.4g}", size, placed)


def arrows(axis: Axes, bubbles: pd.DataFrame, shape: tuple[int, ...], settings: Figures) -> None:
    """Arrows of the motion, longer than true where that would be too short to see.

    More than ``ARROWS`` would hide the image, so some are left out then.
    """
    p, width = np.array(scale(settings, 2) * 2), shape[-1] * scale(settings, 2)[0]
    x1, x2, u1, u2 = p[:, None] * motions(bubbles, ARROWS)
    factor = enlarged(u1, u2, width)
    style: Any = {"color": "#ff4d2e", "angles": "xy", "scale_units": "xy", "scale": 1 / factor}
    axis.quiver(
        x1, x2, u1, u2, width=0.0045, headwidth=3.5, headlength=3.5, headaxislength=3, **style
    )
    if factor > 1:
        _title(axis, f"{axis.get_title('left')}, motion x {factor}")


def name_axes(axes: NDArray, settings: Figures) -> None:
    """Name the outer axes; the inner ones keep only their ticks."""
    unit = unit_name(settings)
    for (i, j), axis in np.ndenumerate(axes):
        axis.tick_params(labelbottom=i == len(axes) - 1, labelleft=j == 0)
        if i == len(axes) - 1:
            axis.set_xlabel(f"lateral position [{unit}]")
        if j == 0:
            axis.set_ylabel(f"axial position [{unit}]")


def _lengths(shape: tuple[int, ...], settings: Figures) -> tuple[float, float]:
    """Width and height of a picture in true lengths."""
    rows, columns = picture(np.broadcast_to(np.uint8(0), shape), settings.sides(len(shape))).shape
    p1, p2 = side(settings.sides(len(shape)), len(shape))
    return columns * p1, rows * p2


def _extent(
    shape: tuple[int, ...], ndim: int, settings: Figures
) -> tuple[float, float, float, float]:
    height, width = shape
    p1, p2 = side(scale(settings, ndim), ndim)
    return (-p1 / 2, (width - 0.5) * p1, (height - 0.5) * p2, -p2 / 2)


def _colours(look: Look) -> tuple[Colormap, Normalize]:
    if look.colours == "share":
        return ListedColormap(["#d9a441", "#cfd8cf", "#5b8a72"]), BoundaryNorm(SHARES, 3)
    return colormaps[look.colours], Normalize(*look.limits)


def _colour_bar(axis: Axes, colours: Colormap, norm: Normalize, look: Look) -> None:
    """A colour bar as high as the axes; as an image, which takes a tenth of the time of one."""
    figure: Any = axis.figure
    box = axis.get_position()
    inch = 1 / figure.get_size_inches()[0]
    bar = figure.add_axes((box.x1 + BAR_GAP * inch, box.y0, BAR * inch, box.height))
    low, high = look.limits
    ramp = np.linspace(low, high, 256)[:, None]
    bar.imshow(ramp, colours, norm=norm, extent=(0, 1, low, high), aspect="auto", origin="lower")
    bar.set_xticks([])
    bar.yaxis.tick_right()
    if look.colours == "share":
        middles = (np.array(SHARES[1:]) + SHARES[:-1]) / 2
        bar.set_yticks(middles, DECIDES)
    else:
        bar.yaxis.set_major_locator(MaxNLocator(5))


def _title(axis: Axes, title: str) -> None:
    """A title that begins with the image, in letters as small as it takes."""
    figure: Any = axis.figure
    box = axis.get_position().width * figure.get_size_inches()[0]
    letters = len(title.replace("$", "").replace("_", "").replace("{", "").replace("}", ""))
    needed = letters * LETTER * TITLE_SIZE / 72
    size = min(1.0, (box + BAR_LABELS) / max(needed, 1e-9)) * TITLE_SIZE
    # A place that is said is not sought.
    axis.set_title(title, fontsize=size, loc="left", y=1.0)


def _name_sections(axis: Axes, shape: tuple[int, ...], settings: Figures) -> None:
    """Ticks along the section from in front, and the names of the other two."""
    _, height, width = (n * p for n, p in zip(shape, scale(settings, 3)[::-1], strict=True))
    for n, set_ticks in ((width, axis.set_xticks), (height, axis.set_yticks)):
        ticks = np.asarray(MaxNLocator(4).tick_values(0, n))
        set_ticks(ticks[(ticks >= 0) & (ticks <= n)])
    style: Any = {"fontsize": 6, "color": "0.25"}
    right, bottom = axis.get_xlim()[1], axis.get_ylim()[0]
    axis.text(right, bottom, "right: from the side\nbelow: from above", ha="right", **style)
    for spine in axis.spines.values():
        spine.set_visible(False)


def _says_something(line: Array) -> bool:
    """Whether a level line, in parts of the picture, goes somewhere."""
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    extent = float(np.hypot(*np.ptp(line, axis=0)))
    return SHORTEST < length < WINDING * max(extent, 1e-9)


def _place_label(axis: Axes, line: Array, text: str, size: Array, placed: list[Array]) -> None:
    """Write a level at the point of its line that is farthest from borders and other labels."""
    at = line[:: max(1, len(line) // 60)] / size
    room = np.minimum(at, 1 - at).min(axis=1)
    for other in placed:
        room = np.minimum(room, np.abs((at - other) / [1.6, 0.9]).max(axis=1))
    best = int(room.argmax())
    if room[best] < 0.06:
        return
    placed.append(at[best])
    x, y = at[best] * size
    label = axis.text(x, y, text, fontsize=6, ha="center", va="center")
    label.set_path_effects([withStroke(linewidth=1.5, foreground="white", alpha=0.8)])
