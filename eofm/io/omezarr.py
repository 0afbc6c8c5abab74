"""Zarr folders, with the axes and sizes of OME-Zarr; runs in the child of `apart`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def read(
    path: str, part: str, largest: int
) -> tuple[list[str], NDArray | None, str, dict[str, tuple[Any, Any]]]:
    """The arrays of a folder, and that which is named, the finest, or the only one."""
    names, data, axes, sizes = find(path, part)
    if data is None:
        return names, None, axes, sizes
    size = data.size * max(data.dtype.itemsize, 8)
    if size > largest:
        raise ValueError(
            f"it asks for {size / 2**30:.3g} GiB (shape {data.shape}), more than the"
            f" {largest / 2**30:.3g} GiB allowed; crop it, or allow more by --max-size"
        )
    return names, np.asarray(data[...]), axes, sizes


def find(path: str, part: str) -> tuple[list[str], Any, str, dict[str, tuple[Any, Any]]]:
    """The same, with the array not yet read."""
    import zarr

    zarr.config.set({"async.concurrency": 2, "threading.max_workers": 2})
    node = zarr.open(path, mode="r")
    image: dict[str, Any] = {}
    if isinstance(node, zarr.Array):
        found = {"": node}
    else:
        members = sorted(node.members(4), key=lambda member: member[0])
        found = {name: each for name, each in members if isinstance(each, zarr.Array)}
        said: Any = node.attrs.get("ome", node.attrs)
        image = _first(said.get("multiscales"))
    levels = {level.get("path"): level for level in _each(image.get("datasets"))}
    chosen = part or next(iter(levels), next(iter(found), "") if len(found) == 1 else None)
    if chosen not in found:
        return [name for name in found if name], None, "", {}
    data = found[chosen]
    if data.dtype.kind not in "biufc":
        raise ValueError(f"it holds {data.dtype} values; save numbers")
    axes, units = _axes(image.get("axes"), data)
    scales = [1.0] * len(axes) if chosen in levels else []
    for level in (levels.get(chosen, {}), image) if scales else ():
        for step in _each(level.get("coordinateTransformations")):
            if step.get("type") == "scale" and len(step.get("scale", ())) == len(axes):
                scales = [a * float(b) for a, b in zip(scales, step["scale"], strict=True)]
    sizes = dict(zip(axes, zip(scales, units, strict=False), strict=False))
    return list(found), data, axes, {a: s for a, s in sizes.items() if a in "XYZ"}


def _axes(stated: Any, data: Any) -> tuple[str, list[Any]]:
    """A letter for each axis, and the unit along it."""
    named = [a if isinstance(a, dict) else {"name": a} for a in stated or ()]
    if len(named) != data.ndim:
        names = getattr(data.metadata, "dimension_names", None) or ()
        named = [{"name": name} for name in names]
    if len(named) != data.ndim:
        return "Q" * (data.ndim - 2) + "YX"[-data.ndim :], [None] * data.ndim
    letters = [str(a.get("name")).upper() for a in named]
    axes = "".join(letter if letter in tuple("TCZYX") else "Q" for letter in letters)
    axes = axes if axes.endswith("YX") or "Q" not in axes[-2:] else axes[:-2] + "YX"
    return axes, [a.get("unit") for a in named]


def _first(several: Any) -> dict[str, Any]:
    return next(iter(_each(several)), {})


def _each(several: Any) -> list[dict[str, Any]]:
    return [e for e in several if isinstance(e, dict)] if isinstance(several, list) else []
