"""NIfTI files; runs in the child of `apart`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Array axes of the file, in its order: X lateral, Y axial, Z elevational, time, anything.
AXES = "XYZTCQQ"


def read(
    path: str, part: str, largest: int
) -> tuple[list[str], NDArray | None, str, dict[str, tuple[Any, Any]]]:
    """The image of a file; its first axis is lateral."""
    import nibabel

    kind = nibabel.Nifti2Image if _is_second(path) else nibabel.Nifti1Image
    image = kind.from_filename(path)
    shape, stored = image.shape, image.get_data_dtype()
    if stored.kind not in "iufc":
        raise ValueError("it is in colour; convert it to greyscale first")
    size = int(np.prod(shape, dtype=object)) * max(stored.itemsize, 8)
    if size > largest:
        raise ValueError(
            f"it asks for {size / 2**30:.3g} GiB (shape {shape}), more than the"
            f" {largest / 2**30:.3g} GiB allowed; crop it, or allow more by --max-size"
        )
    zooms = image.header.get_zooms()
    unit = image.header.get_xyzt_units()[0]
    sides = {axis: (float(side), unit) for axis, side in zip(AXES, zooms, strict=False)}
    if {side for side, _ in list(sides.values())[:3]} == {1.0}:  # nobody has said anything
        sides = {}
    values = np.asanyarray(image.dataobj).T
    axes = AXES[: values.ndim][::-1]
    return [], values, axes, {a: s for a, s in sides.items() if a in "XYZ"}


def _is_second(path: str) -> bool:
    """Whether the header has the length of the format's second version."""
    import gzip

    with open(path, "rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    with gzip.open(path) if packed else open(path, "rb") as file:
        head = file.read(4)
    return 540 in (int.from_bytes(head, "little"), int.from_bytes(head, "big"))
