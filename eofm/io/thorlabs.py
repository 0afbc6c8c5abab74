"""The ``.oct`` files of Thorlabs' OCT systems: a zip with Header.xml and data/NAME.data.

The header lists the data files: for each its type, the number of values along Z (depth, varies
fastest), X and Y, and the ranges of these, mm. "Real" are float32, such as Intensity in dB,
"Complex" pairs of them. Written from what public readers say of the format.
"""

import os
import re
import zipfile
from xml.etree import ElementTree

import numpy as np

from eofm.errors import InputError
from eofm.io.limits import LARGEST_TEXT, check_size
from eofm.io.scan import Scan, choose, micrometres

HEADER = "header.xml"
REAL, COMPLEX = 4, 8
# What is read unless another one is named.
FIRST = ("Intensity", "Complex")
# Axes of the array and how the header calls them: slices are B-scans, rows are depth.
CALLED = {"Z": "Y", "Y": "Z", "X": "X"}


def read_oct(name: str, part: str) -> Scan:
    """Read the intensity or what is named: a B-scan, or a volume of them.

    Raises
    ------
    InputError
        If there is nothing but raw spectra, or the array is too large.
    ValueError
        If the file is damaged.
    """
    check_size(name, [os.path.getsize(name)], 1)
    with zipfile.ZipFile(name) as archive:
        # Names may have the slashes of Windows.
        members = {i.filename.replace("\\", "/").lower(): i for i in archive.infolist()}
        if HEADER not in members:
            raise ValueError("there is no Header.xml in it")
        listed = _listed(_extract(archive, members[HEADER], LARGEST_TEXT))
        usable = {k: v for k, v in listed.items() if v.get("Type") in ("Real", "Complex")}
        usable = {k: v for k, v in usable.items() if _count(v, "SizeX") > 1}
        if not usable:
            raise InputError(f"{name}: holds no image but raw spectra; save the intensity with it")
        first = next((each for each in FIRST if each in usable), "")
        chosen = usable[choose(name, sorted(usable), part or first)]
        place = (chosen.text or "").strip().replace("\\", "/").lower()
        if place not in members:
            raise ValueError(f"there is no {place} in it")
        counts = {axis: _count(chosen, f"Size{CALLED[axis]}") for axis in "ZYX"}
        ranges = {axis: chosen.get(f"Range{CALLED[axis]}") for axis in "ZYX"}
        item = COMPLEX if chosen.get("Type") == "Complex" else REAL
        shape = counts["Z"], counts["X"], counts["Y"]
        check_size(name, shape, item)
        size = int(np.prod(shape, dtype=object))
        stored = members[place].file_size
        if item == COMPLEX and stored == size * REAL:  # the header may count real values
            item, shape = REAL, (*shape[:2], 2 * (shape[2] // 2))
        if stored < size * item:
            raise ValueError(f"shape {shape} is stated, {stored} bytes are there")
        data = _extract(archive, members[place], size * item)
    kind = "<c8" if chosen.get("Type") == "Complex" else "<f4"
    values = np.frombuffer(data, kind).reshape(*shape[:2], -1)
    sides = {axis: _side(ranges[axis], counts[axis]) for axis in "XYZ"}
    return Scan(values.transpose(0, 2, 1), "ZYX", micrometres(sides, "mm"))


def _listed(header: bytes) -> dict[str, ElementTree.Element]:
    """Data files by their names without folder and ending."""
    if re.search(rb"<!(DOCTYPE|ENTITY)", header, re.IGNORECASE):
        raise ValueError("its header defines entities")
    files = ElementTree.fromstring(header).iter("DataFile")
    named = ((re.split(r"[\\/]", (each.text or "").strip())[-1], each) for each in files)
    return {name.rpartition(".")[0] or name: each for name, each in named}


def _extract(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most: int) -> bytes:
    """The first bytes of a member, as many as there may be."""
    with archive.open(member) as file:
        return file.read(most)


def _count(data: ElementTree.Element, key: str) -> int:
    """A number of values; what is not stated has one."""
    count = int(data.get(key, "1"))
    if count < 1:
        raise ValueError(f"{key} is {count}")
    return count


def _side(length: str | None, count: int) -> float | None:
    try:
        return float(length or "") / count
    except ValueError:
        return None
