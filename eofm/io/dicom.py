"""DICOM files; runs in the child of `apart`."""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Code of centimetres in the regions of ultrasound.
CENTIMETRES = 3


def read(
    path: str, part: str, largest: int
) -> tuple[list[str], NDArray | None, str, dict[str, tuple[Any, Any]]]:
    """The image or the frames of a file, in the units that it says to rescale to."""
    import pydicom
    from pydicom.pixels import apply_rescale

    if os.path.getsize(path) > largest:
        raise ValueError("it is larger than allowed; allow more by --max-size")
    file = pydicom.dcmread(path)
    if "Rows" not in file:
        raise ValueError("it holds no image")
    count, samples = int(file.get("NumberOfFrames") or 1), int(file.get("SamplesPerPixel") or 1)
    shape = (count, int(file.Rows), int(file.Columns), samples)
    size = int(np.prod(shape, dtype=object)) * 8
    if size > largest:
        raise ValueError(
            f"it asks for {size / 2**30:.3g} GiB (shape {shape}), more than the"
            f" {largest / 2**30:.3g} GiB allowed; crop it, or allow more by --max-size"
        )
    if file.get("PhotometricInterpretation") == "PALETTE COLOR":
        raise ValueError("it has a colour map; convert it to greyscale first")
    values = file.pixel_array
    axes = "YX" + "S" * (samples > 1)
    if count > 1:
        times = "FrameTime" in file or "FrameTimeVector" in file
        axes = ("T" if times else "Z") + axes
    values = apply_rescale(values, file)
    return [], values, axes, _sizes(file)


def _sizes(file: Any) -> dict[str, tuple[Any, Any]]:
    """Distances of rows, columns and slices with their units, as kinds of images state them."""
    shared = file.get("SharedFunctionalGroupsSequence") or [{}]
    measures = (shared[0].get("PixelMeasuresSequence") or [{}])[0]
    sizes: dict[str, tuple[Any, Any]] = {}
    for place in (measures, file):
        rows, columns = place.get("PixelSpacing") or place.get("ImagerPixelSpacing") or (0, 0)
        slices = place.get("SpacingBetweenSlices") or place.get("SliceThickness") or 0
        for axis, side in (("X", columns), ("Y", rows), ("Z", slices)):
            if side:
                sizes.setdefault(axis, (float(side), "mm"))
    regions: Any = file.get("SequenceOfUltrasoundRegions") or ()
    for axis in "XY" if len(regions) == 1 else "":
        side = regions[0].get(f"PhysicalDelta{axis}")
        if side and regions[0].get(f"PhysicalUnits{axis}Direction") == CENTIMETRES:
            sizes.setdefault(axis, (abs(float(side)), "cm"))
    return sizes
