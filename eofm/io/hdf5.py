"""HDF5 files, such as those of MATLAB 7.3; runs in the child of `apart`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# What Fiji and its relatives write of a data set: sides of a voxel in the order of its axes.
ELEMENT = "element_size_um"
# Fields of a complex number as MATLAB saves it.
PARTS = {"real", "imag"}


def read(
    path: str, part: str, largest: int
) -> tuple[list[str], NDArray | None, str, dict[str, tuple[float, str]]]:
    """The data sets of a file, and that which is named, or the only one that there is."""
    import h5py

    with h5py.File(path, "r", locking=False) as file:
        found: dict[str, Any] = {}

        def note(name: str, data: Any) -> None:
            # Links to other files are not visited; MATLAB keeps parts of cells under #refs#.
            if isinstance(data, h5py.Dataset) and _is_numeric(data) and name[0] != "#":
                found[name] = data

        file.visititems(note)
        first = [name for name in found if "/" not in name] or list(found)
        if part not in found and (part or len(first) != 1):
            return list(found), None, "", {}
        data = found[part or first[0]]
        if data.is_virtual or data.external:
            raise ValueError("its values are in another file; save them in one")
        size = data.size * max(data.dtype.itemsize, 8)
        if size > largest:
            raise ValueError(
                f"it asks for {size / 2**30:.3g} GiB (shape {data.shape}), more than the"
                f" {largest / 2**30:.3g} GiB allowed; crop it, or allow more by --max-size"
            )
        values = data[()]
        if data.dtype.kind == "V":
            values = values["real"] + 1j * values["imag"]
        axes = "Q" * (values.ndim - 2) + "YX"
        return list(found), values, axes, _sizes(data.attrs.get(ELEMENT))


def _is_numeric(data: Any) -> bool:
    text = data.attrs.get("MATLAB_class") == b"char"
    complex_parts = data.dtype.kind == "V" and set(data.dtype.names or ()) == PARTS
    return (data.dtype.kind in "biufc" or complex_parts) and data.ndim > 1 and not text


def _sizes(stated: Any) -> dict[str, tuple[float, str]]:
    """Sides with their unit by axis; the last three axes of the data are Z, Y and X."""
    sides = np.ravel([] if stated is None else stated)
    if sides.dtype.kind not in "iuf" or len(sides) < 2:
        return {}
    named = zip("XYZ", sides[::-1], strict=False)
    return {axis: (float(side), "um") for axis, side in named}
