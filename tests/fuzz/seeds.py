"""Sound files of every kind that is read, small, and ways to damage them."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import h5py
import nibabel
import numpy as np
import tifffile
from made import write_dicom, write_mha, write_nrrd, write_oct, write_zarr
from PIL import Image
from pydicom.uid import ExplicitVRLittleEndian, RLELossless
from scipy.io import savemat

from eofm.io import write_field

I = np.arange(120, dtype=np.uint8).reshape(10, 12)
STACK = np.arange(240, dtype=np.uint16).reshape(2, 10, 12)
COLOURS = np.arange(768, dtype=np.uint16).reshape(3, 256)
TIFFS = (
    {"data": I},
    {"data": STACK, "imagej": True},
    {"data": STACK, "ome": True},
    {"data": I, "compression": "zlib", "predictor": True},
    {"data": I, "bigtiff": True, "byteorder": ">"},
    {"data": np.zeros((32, 32), np.float32), "tile": (16, 16)},
    {"data": np.stack([I] * 3, -1), "photometric": "rgb"},
    {"data": I, "photometric": "palette", "colormap": COLOURS},
)
TABLE = b"x1,x2,u1,u2,quality\n20,30,2.5,2.2,0.9\n1e1,2,-3,4.25,\n3,4,5,6,7\n"
SETTINGS = b"top: fixed\nbottom: moved 0 -3\nroi: [0, 0, 40, 40]\nalpha: 1e-2\nb: &x {c: 'd'}\n"
SAMPLES = b"sample\treference\tdeformed\troi\n# no\na\tx.tif#3\ty.tif\t0 0 9 9\nb\tp.tif\tq.tif\n"
# What readers of numbers, lengths and texts stumble over.
WORDS = (b"\0", b"\xff\xfe", b'"', b"'", b",", b"\n", b"\t", b"-", b"nan", b"inf", b"1e999")
WORDS += (b"9" * 400, b"[" * 400, b"{" * 400, b"&a", b"*a", b"<<: ", b"!!binary ", b"!!set ", b"#")
WORDS += (b"%s", b"--folder=x", b"\xe2\x80\xa8", b"2001-99-99", b"0x", b"1_0", b": ", b"? ", b"|\n")
LENGTHS = (0, 1, 2, 3, 7, 8, 127, 128, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63)


def sound(folder: Path) -> dict[str, list[bytes]]:
    """Sound files by the kind of their reader."""
    found: dict[str, list[bytes]] = {".tif": []}
    for more in TIFFS:
        file = io.BytesIO()
        tifffile.imwrite(file, **more)
        found[".tif"].append(file.getvalue())
    write_field(folder / "u.tif", STACK)
    found[".tif"].append((folder / "u.tif").read_bytes())
    file = io.BytesIO()
    Image.fromarray(I).save(file, "TIFF", compression="packbits")
    found[".tif"].append(file.getvalue())
    found[".png"] = []
    for image in (Image.fromarray(I), Image.fromarray(STACK[0]), Image.fromarray(I).convert("P")):
        file = io.BytesIO()
        image.save(file, "PNG")
        found[".png"].append(file.getvalue())
    arrays = (I, STACK.astype(">f4"), np.asfortranarray(I.astype(complex)), I > 5)
    found[".npy"] = [_npy(array) for array in arrays]
    found[".npz"] = [_npz(found[".npy"][0]), _npz(*found[".npy"][:2])]
    found[".mat"] = []
    for array in (I.astype(float), STACK, I > 5, {"a": 1}, I * 1j):
        for packed in (False, True):
            file = io.BytesIO()
            savemat(file, {"A": array}, do_compression=packed)
            found[".mat"].append(file.getvalue())
    found["hdf5"] = []
    for more in ({}, {"chunks": (5, 6), "compression": "gzip", "shuffle": True}):
        with h5py.File(folder / "A.mat", "w", libver="latest" if more else "earliest") as file:
            file.create_dataset("A", data=I, **more).attrs["MATLAB_class"] = b"uint8"
        found["hdf5"].append((folder / "A.mat").read_bytes())
    with h5py.File(folder / "A.h5", "w") as file:
        file["scan/V"] = STACK * (1 + 1j)
        file["scan/V"].attrs["element_size_um"] = [3.0, 2.0, 1.0]
        parts = np.zeros(I.shape, [("real", "f8"), ("imag", "f8")])  # as MATLAB saves them
        file.create_dataset("#refs#/A", data=parts).attrs["MATLAB_class"] = b"double"
    found["hdf5"].append((folder / "A.h5").read_bytes())
    found |= _foreign(folder)
    return found | {".csv": [TABLE], ".yaml": [SETTINGS], ".tsv": [SAMPLES]}


def _foreign(folder: Path) -> dict[str, list[bytes]]:
    """Those of other instruments."""
    found: dict[str, list[bytes]] = {}

    def take(kind: str, path: Path) -> None:
        found.setdefault(kind, []).append(path.read_bytes())

    values = STACK.astype(np.float32)
    for packed in (False, True):
        write_mha(folder / "A.mha", values, "0.1 0.2 0.3", packed)
        take(".mha", folder / "A.mha")
        more = 'spacings: .1 .2 .3\nunits: "mm" "mm" "mm"\nkinds: space space space\n'
        write_nrrd(folder / "A.nrrd", values, packed, more)
        take(".nrrd", folder / "A.nrrd")
        kind = ("Complex", values * 1j) if packed else ("Real", values)
        listed = {"Intensity": (kind[1].astype("<c8" if packed else "<f4"), kind[0])}
        write_oct(folder / "A.oct", listed, packed=zipfile.ZIP_DEFLATED * packed)
        take(".oct", folder / "A.oct")
        write_dicom(folder / "A.dcm", STACK, (ExplicitVRLittleEndian, RLELossless)[packed])
        take("dicom", folder / "A.dcm")
        make = (nibabel.Nifti1Image, nibabel.Nifti2Image)[packed]
        nibabel.save(make(values.T, np.diag([0.1, 0.2, 0.3, 1])), folder / "A.nii")
        take("nifti", folder / "A.nii")
        write_zarr(folder / "A.zarr", values, 3 if packed else 2)
        files = [file for file in sorted((folder / "A.zarr").rglob("*")) if file.is_file()]
        named = {str(f.relative_to(folder / "A.zarr")): f.read_bytes() for f in files}
        found.setdefault("zarr", []).append(_packed(named))
    return found


def members(packed: bytes) -> dict[str, bytes]:
    """The files of a folder that is packed in a file."""
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _packed(files: dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return file.getvalue()


def damaged(kind: str, sounds: list[bytes], random: Random) -> bytes:
    """A file of a kind with one to eight changes, in places where they are not just noticed."""
    data = random.choice(sounds)
    change = damage
    if kind == ".tif" and random.random() < 0.7:  # the headers, not the pixels
        return _part(data, random, lambda d: change(d, random), 400)
    if kind == ".png" and random.random() < 0.5:
        return _png(data, random)
    if kind == ".npy" and random.random() < 0.7:
        return _part(data, random, lambda d: change(d, random), 128)
    if kind == ".npz" and random.random() < 0.5:
        return _npz(_part(_npy(I), random, lambda d: change(d, random), 128))
    if kind == ".mat" and random.random() < 0.5:
        return _mat(data, random)
    if kind in (".mha", ".nrrd", "dicom", "nifti") and random.random() < 0.7:
        return _part(data, random, lambda d: change(d, random), 400)
    if kind == "zarr" or (kind == ".oct" and random.random() < 0.7):
        files = members(data)
        name = random.choice(sorted(files))
        return _packed(files | {name: change(files[name], random)})
    return change(data, random)


def damage(data: bytes, random: Random) -> bytes:
    """One to eight changes of bytes."""
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 3, 8))):
        at = random.randrange(len(changed) + 1)
        how = random.randrange(7)
        if how == 0 and at < len(changed):
            changed[at] ^= 1 << random.randrange(8)
        elif how == 1:
            changed[at : at + 1] = bytes([random.randrange(256)])
        elif how == 2:
            number = struct.pack(random.choice("<>") + "Q", random.choice(LENGTHS))
            width = random.choice((1, 2, 4, 8))
            changed[at : at + width] = number[:width] if random.random() < 0.5 else number[-width:]
        elif how == 3:
            del changed[at : at + random.choice((1, 2, 4, 12, 100))]
        elif how == 4:
            changed[at:at] = random.choice(WORDS)
        elif how == 5:
            there = random.randrange(len(changed) + 1)
            changed[at : at + 12] = changed[there : there + 12]
        elif random.random() < 0.3:
            del changed[at:]
    return bytes(changed)


def _part(data: bytes, random: Random, change: Callable[[bytes], bytes], size: int) -> bytes:
    """Change the beginning or the end of a file only."""
    if random.random() < 0.5:
        return change(data[:size]) + data[size:]
    return data[:-size] + change(data[-size:])


def _png(data: bytes, random: Random) -> bytes:
    """Change the content of chunks, whose check sums are right again then."""
    changed, at = data[:8], 8
    while at + 12 <= len(data):
        length = struct.unpack(">I", data[at : at + 4])[0]
        body = data[at + 4 : at + 8 + length]
        if random.random() < 0.5:
            body = body[:4] + damage(body[4:], random)
        changed += struct.pack(">I", max(len(body) - 4, 0)) + body
        changed += struct.pack(">I", zlib.crc32(body))
        at += 12 + length
    return changed


def _mat(data: bytes, random: Random) -> bytes:
    """Change what is compressed, and compress it again."""
    kind, length = struct.unpack("<II", data[128:136])
    if kind != 15:
        return data[:128] + damage(data[128:], random)
    body = zlib.compress(damage(zlib.decompress(data[136 : 136 + length]), random))
    return data[:128] + struct.pack("<II", 15, len(body)) + body


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _npz(*members: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for number, member in enumerate(members):
            archive.writestr(f"arr_{number}.npy", member)
    return file.getvalue()


def make() -> dict[str, list[bytes]]:
    """Sound files, made in a folder of their own."""
    with TemporaryDirectory() as folder:
        return sound(Path(folder))
