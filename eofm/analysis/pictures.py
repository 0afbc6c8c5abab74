"""Arrays as pictures of a page: PNG in the text, colours that go with both backgrounds."""

import base64
import io
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eofm.analysis.arrows import enlarged, motions
from eofm.analysis.sections import picture
from eofm.grid import Array

# Largest number of samples along the sides of a picture, and of arrows in it.
SIDE, ARROWS = 480, 300
# The last colour of a picture shows where there is no value.
COLOURS = 255
STOPS = 9
# What decides the estimate, and from which share of the images on: see `panels.SHARES`.
STEPS = {"share": ((0.0, "#d9a441"), (0.1, "#b9c4b9"), (0.5, "#5b8a72"))}


def png(
    values: Array,
    limits: tuple[float, float],
    colours: str,
    pixel_size: tuple[float, ...],
    side: int = SIDE,
) -> tuple[str, tuple[float, float]]:
    """A picture of an image or of the sections of a volume, and its size in true lengths.

    Parameters
    ----------
    values : ndarray, shape (height, width) or (depth, height, width)
        NaN is see-through.
    limits : (low, high)
        Values of the first and the last colour.
    colours : str
        A colour map of matplotlib, or ``share``.
    pixel_size : (lateral, axial) or (lateral, axial, elevational)
    side : int
        Largest number of samples; larger images are averaged.

    Returns
    -------
    str
        ``data:`` address.
    (width, height)
    """
    from PIL import Image

    shown = picture(values, pixel_size)
    p1, p2 = (min(pixel_size),) * 2 if values.ndim == 3 else pixel_size
    size = shown.shape[1] * p1, shown.shape[0] * p2
    shown = _reduced(shown, side)
    low, high = limits
    with np.errstate(invalid="ignore"):
        level = np.clip((shown - low) / (high - low) * COLOURS, 0, COLOURS - 1)
    index = np.where(np.isfinite(shown), level, COLOURS).astype(np.uint8)
    drawn = Image.fromarray(index, "P")
    drawn.putpalette(palette(colours).tobytes())
    file = io.BytesIO()
    drawn.save(file, "PNG", transparency=COLOURS, compress_level=9)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode(), size


@cache
def palette(colours: str) -> NDArray[np.uint8]:
    """The colours from the lowest value to the highest, shape (256, 3)."""
    at = (np.arange(COLOURS) + 0.5) / COLOURS
    if colours in STEPS:
        first = [at for at, _ in STEPS[colours]]
        rgb = [colour for _, colour in STEPS[colours]]
        table = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in rgb])
        found = table[np.searchsorted(first, at, "right") - 1]
    else:
        from matplotlib import colormaps

        found = colormaps[colours](at, bytes=True)[:, :3]
    return np.vstack([found, [[0, 0, 0]]]).astype(np.uint8)


def gradient(colours: str) -> str:
    """The colours as a gradient of a style sheet, from left to right."""
    table = palette(colours)
    if colours in STEPS:
        ends = [*(at for at, _ in STEPS[colours]), 1.0]
        stops = [
            f"{colour} {100 * a:g}% {100 * b:g}%"
            for (_, colour), a, b in zip(STEPS[colours], ends, ends[1:], strict=False)
        ]
    else:
        chosen = np.linspace(0, COLOURS - 1, STOPS).round().astype(int)
        stops = ["#{:02x}{:02x}{:02x}".format(*table[k]) for k in chosen]
    return f"linear-gradient(90deg, {', '.join(stops)})"


def motion(bubbles: pd.DataFrame, shape: tuple[int, ...]) -> tuple[str, float]:
    """Arrows of the bubbles' motions as a path in px of the image, and how often enlarged."""
    x, y, u, v = motions(bubbles, ARROWS)
    factor = enlarged(u, v, shape[1])
    paths = []
    for x0, y0, dx, dy in zip(x + 0.5, y + 0.5, factor * u, factor * v, strict=True):
        x1, y1 = x0 + dx, y0 + dy
        # Heads are a third of the shaft.
        sides = [(-0.33 * dx - s * 0.2 * dy, -0.33 * dy + s * 0.2 * dx) for s in (1, -1)]
        head = "".join(f"M{x1:.1f} {y1:.1f}l{a:.1f} {b:.1f}" for a, b in sides)
        paths.append(f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}{head}")
    return "".join(paths), factor


def _reduced(values: Array, side: int) -> Array:
    """Means of blocks, so that no side has more than so many samples."""
    step = -(-max(values.shape) // side)
    if step == 1:
        return values
    # Not larger than the image is.
    a, b = (min(step, n) for n in values.shape)
    rows, columns = values.shape[0] // a, values.shape[1] // b
    blocks = values[: rows * a, : columns * b].reshape(rows, a, columns, b)
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, 0).sum(axis=(1, 3))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
