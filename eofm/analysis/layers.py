"""The results in a folder as layers of napari, which need not be installed for this."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile

from eofm.analysis.tensors import NAMES, labels
from eofm.errors import InputError
from eofm.grid import Array

# Data, arguments and kind, as `napari.layers.Layer.create` wants them.
Layer = tuple[Array, dict[str, Any], str]

# Vectors along the longest side.
VECTORS = 32


def layers(folder: Path) -> list[Layer]:
    """Layers from the bottom to the top, of which few are visible at first.

    Parameters
    ----------
    folder : Path
        What `eofm sample` or `Analysis.write` has written to.

    Returns
    -------
    list of (data, arguments, kind)

    Raises
    ------
    InputError
        If there are no complete results in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder")
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        sides = [float(side) for side in summary["pixel_size_um"]]
        images = _pages(folder / "images.tif", len(sides))
        u = _pages(folder / "displacement.tif", len(sides))
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            f"{folder}: holds no complete results; make them with eofm sample"
        ) from None
    unit = "um" if summary.get("pixel_size_from") else "px"
    lengths = {"scale": sides[::-1], "units": ["um" if unit == "um" else "pixel"] * len(sides)}
    return [
        (data, {**more, **lengths}, kind)
        for data, more, kind in _layers(folder, images, u, sides, unit)
    ]


def _layers(
    folder: Path, images: Array, u: Array, sides: list[float], unit: str
) -> Iterator[Layer]:
    n = len(sides)
    for values, name in zip(images, ("before", "after"), strict=True):
        yield values, {"name": name, "colormap": "gray", "visible": name == "before"}, "image"
    factors = sides if unit == "um" else [1.0] * n
    for i in range(n):
        name = f"u{i + 1} {NAMES[i]} [{unit}]"
        yield _image(factors[i] * u[i], name, "viridis" if i == 1 else "diverging")
    if (path := folder / "deviation.tif").is_file():
        for i, bars in enumerate(_pages(path, n)):
            yield _image(factors[i] * bars, f"error bar of u{i + 1} [{unit}]", "magma")
    for file, names, colours in (
        ("strain", labels(n), "diverging"),
        ("trust", ["match of the images"], "cividis"),
        ("stiffness", ["relative modulus"], "viridis"),
    ):
        path = folder / f"{file}.tif"
        if path.is_file():
            for values, name in zip(_pages(path, n), names, strict=True):
                yield _image(values, name, colours)
    yield _vectors(u)
    yield from _bubbles(folder / "bubbles.csv", n)


def _pages(path: Path, ndim: int) -> Array:
    """Pages, or volumes, of a file that was written here; components first."""
    values = tifffile.imread(path)
    if values.ndim == ndim:
        return values[None]
    return np.moveaxis(values, -3, 0) if values.ndim == ndim + 1 else values


def _image(values: Array, name: str, colours: str) -> Layer:
    """A map that is not shown at first; of deviations from zero, about zero."""
    low, high = (float(v) for v in np.nanpercentile(values, (0.5, 99.5)))
    if colours == "diverging":
        high = max(abs(low), abs(high))
        low, colours = -high, "RdBu_r"
    limits = [low, high] if high > low else [low - 0.5, high + 0.5]
    more = {"name": name, "colormap": colours, "contrast_limits": limits, "visible": False}
    return values, more, "image"


def _vectors(u: Array) -> Layer:
    """Displacement on a coarse grid: start and way, in px, in the order of the axes."""
    shape = u.shape[1:]
    step = max(1, -(-max(shape) // VECTORS))
    at = np.stack(np.meshgrid(*(np.arange(step // 2, k, step) for k in shape), indexing="ij"))
    at = at.reshape(len(shape), -1)
    way = u[::-1, *at]
    known = np.isfinite(way).all(axis=0)
    vectors = np.stack([at.T, way.T], axis=1)[known].astype(np.float64)
    longest = float(np.linalg.norm(vectors[:, 1], axis=1).max(initial=1e-9))
    more = {"name": "displacement", "length": max(1.0, step / longest), "edge_color": "orange"}
    looks = {"edge_width": max(0.2, step / 8), "vector_style": "arrow", "visible": True}
    return vectors, more | looks, "vectors"


def _bubbles(path: Path, n: int) -> Iterator[Layer]:
    """Centres of the bubbles of the first step."""
    if not path.is_file():
        return
    table = pd.read_csv(path)
    table = table[table["step"] == 1]
    at = table[[f"x{i + 1}" for i in range(n)]].to_numpy(float)[:, ::-1]
    more = {"name": "bubbles", "size": 3, "face_color": "transparent", "border_color": "red"}
    yield at, {**more, "visible": False}, "points"
