"""Files that are damaged, or made to do harm: one clear line each, soon, and nothing else."""

import io as memory
import os
import struct
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
from PIL import Image
from scipy.io import savemat
from scipy.sparse import csc_array

from eofm import io
from eofm.errors import InputError

CORPUS = Path(__file__).parent.parent / "fuzz" / "corpus"
I = np.arange(42, dtype=np.uint8).reshape(6, 7)


@pytest.fixture(autouse=True)
def _small():
    io.limit_size(1.0)
    yield
    io.limit_size(None)


def refused(path, message):
    with pytest.raises(InputError, match=message) as caught:
        io.read_image(Path(path))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


def test_a_matlab_file_that_crashes_scipy():
    refused(CORPUS / "matlab5_signal11.mat", "cannot be read as MAT")


def test_a_tiff_whose_next_page_is_no_page():
    refused(CORPUS / "tiff_next_page_256.tif", "page 1")


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int16, np.uint8, np.int64, bool])
@pytest.mark.parametrize("compressed", [True, False])
@pytest.mark.parametrize("shape", [(6, 7), (1, 9), (6, 7, 2)])
def test_matlab_arrays_are_what_scipy_wrote(tmp_path, kind, compressed, shape):
    A = (np.random.default_rng(0).normal(size=shape) * 50).astype(kind)
    others = {"name": "a text", "cell": {"a": 1}}
    savemat(tmp_path / "A.mat", {"A": A} | others, do_compression=compressed)
    read = io.formats.read_array(tmp_path / "A.mat#A").values
    np.testing.assert_array_equal(read, np.moveaxis(A, -1, 0) if len(shape) == 3 else A)
    assert read.dtype == A.dtype


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (csc_array(np.eye(5)), "is sparse; save a full array"),
        ("text", "is text; save a full array"),
    ],
)
def test_matlab_variables_that_are_no_images(tmp_path, value, message):
    savemat(tmp_path / "A.mat", {"A": value, "B": np.eye(3)})
    refused(tmp_path / "A.mat#A", message)
    assert io.read_image(tmp_path / "A.mat#B").shape == (3, 3)


def test_a_compressed_matlab_array_that_asks_for_the_memory(tmp_path):
    head = struct.pack("<IIIIII", 6, 8, 6, 0, 5, 8) + struct.pack("<ii", 40000, 40000)
    array = head + struct.pack("<II", 1 << 16 | 1, ord("A")) + struct.pack("<II", 9, 1 << 31)
    body = zlib.compress(struct.pack("<II", 14, 1 << 31) + array)
    text = b" " * 124 + b"\x00\x01IM"
    (tmp_path / "A.mat").write_bytes(text + struct.pack("<II", 15, len(body)) + body)
    refused(tmp_path / "A.mat", "asks for 11.9 GiB")


def hdf5(path, **settings):
    with h5py.File(path, "w") as file:
        file.create_dataset("A", **settings)
    return path


def test_matlab_7_3_is_read_in_a_child(tmp_path):
    hdf5(tmp_path / "A.mat", data=I.T)
    np.testing.assert_array_equal(io.read_image(tmp_path / "A.mat"), I)
    hdf5(tmp_path / "C.mat", shape=(40000, 40000), dtype="f8", chunks=(8, 8))
    assert (tmp_path / "C.mat").stat().st_size < 5000
    refused(tmp_path / "C.mat", "asks for 11.9 GiB")
    refused(tmp_path / "A.mat#B", "name a variable, as in .*A.mat#A; it holds A")


def test_hdf5_leads_to_no_other_file(tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(42))
    external = [(str(secret), 0, 42)]
    hdf5(tmp_path / "A.mat", shape=(6, 7), dtype="u1", external=external)
    refused(tmp_path / "A.mat", "its values are in another file")
    hdf5(tmp_path / "B.mat", data=I)
    with h5py.File(tmp_path / "C.mat", "w") as file:
        file["A"] = h5py.ExternalLink(str(tmp_path / "B.mat"), "A")
    refused(tmp_path / "C.mat", "holds none")
    with h5py.File(tmp_path / "D.mat", "w") as file:
        layout = h5py.VirtualLayout((6, 7), "u1")
        layout[:] = h5py.VirtualSource(str(tmp_path / "B.mat"), "A", (6, 7))
        file.create_virtual_dataset("A", layout)
    refused(tmp_path / "D.mat", "its values are in another file")


def test_a_reader_that_crashes_or_never_ends_is_ended(tmp_path, monkeypatch):
    from eofm.io import apart as module

    path = hdf5(tmp_path / "A.mat", data=I)
    child = tmp_path / "child.py"
    monkeypatch.setattr(module, "__file__", str(child))
    child.write_text("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    refused(path, "ends its reader by signal 11")
    child.write_text("while True: pass")
    monkeypatch.setattr("eofm.io.matlab.PATIENCE", 0.2)
    refused(path, "takes longer")


def npy(shape, dtype="<f8", data=b""):
    file = memory.BytesIO()
    header = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue() + data


@pytest.mark.parametrize(
    ("shape", "dtype", "message"),
    [
        ((40000, 40000), "<f8", "asks for 11.9 GiB"),
        ((6, 7), "<f8", "336 bytes|shape \\(6, 7\\) is stated"),
        ((-6, 7), "<f8", "shape"),
        ((6, 7), "|O", "cannot be read"),
        ((6, 7), "|V1000000000", "asks for"),
    ],
)
def test_numpy_headers_that_promise_more_than_there_is(tmp_path, shape, dtype, message):
    (tmp_path / "I.npy").write_bytes(npy(shape, dtype, b"1234"))
    refused(tmp_path / "I.npy", message)
    with zipfile.ZipFile(tmp_path / "I.npz", "w") as archive:
        archive.writestr("I.npy", npy(shape, dtype, b"1234"))
    refused(tmp_path / "I.npz", message)


def test_a_png_that_asks_for_the_memory(tmp_path):
    Image.fromarray(I).save(tmp_path / "I.png")
    data = bytearray((tmp_path / "I.png").read_bytes())
    data[16:24] = struct.pack(">II", 40000, 40000)
    (tmp_path / "I.png").write_bytes(data)
    refused(tmp_path / "I.png", "asks for 11.9 GiB")


def test_a_tiff_that_asks_for_the_memory(tmp_path):
    path = tmp_path / "I.tif"
    tifffile.imwrite(path, I)
    with tifffile.TiffFile(path, mode="r+") as file:
        for name in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            file.pages[0].tags[name].overwrite(40000)
    refused(path, "asks for 11.9 GiB")
    io.limit_size(1e-7)
    tifffile.imwrite(path, I)
    refused(path, "more than the .* allowed; crop it, or allow more by --max-size")


def test_a_deflated_strip_holds_no_more_than_its_strip(tmp_path):
    path = tmp_path / "I.tif"
    tifffile.imwrite(path, I, compression="zlib", predictor=False)
    bomb = zlib.compress(bytes(64 << 20), 9)
    with tifffile.TiffFile(path, mode="r+") as file:
        tags = file.pages[0].tags
        tags["StripOffsets"].overwrite(path.stat().st_size)
        tags["StripByteCounts"].overwrite(len(bomb))
    with path.open("ab") as file:
        file.write(bomb)
    io.limit_size(0.03)
    refused(path, "a part of the image holds more than it says")


def test_greyscale_saved_in_colours_is_read_and_colour_maps_are_not(tmp_path):
    grey = np.stack([I] * 3, axis=-1)
    for name in ("I.tif", "I.png"):
        Image.fromarray(grey).save(tmp_path / name)
        np.testing.assert_array_equal(io.read_image(tmp_path / name), I)
    colours = np.arange(3 * 256, dtype=np.uint16).reshape(3, 256)
    tifffile.imwrite(tmp_path / "map.tif", I, photometric="palette", colormap=colours)
    refused(tmp_path / "map.tif", "has a colour map")


@pytest.mark.parametrize("name", ["a\0b.tif", "x" * 300, "x#0#1", "", "/dev/zero", "/dev/null"])
def test_names_that_are_no_files(name):
    refused(name, "no such file|no regular file|cannot tell")


def test_pipes_are_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.tif")
    refused(tmp_path / "pipe.tif", "is no regular file")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x1,x2,u1,u2\n20,30,2.5,2.2,0.9\n", "more cells than its header"),
        ("x1,x2,u1,u2\n1,2,3,4\n20,30,2.5,2.2,0.9\n", "cannot be read as a CSV"),
        ("x1,x2,u1,u2,u1\n1,2,3,4,5\n", "the column u1 twice"),
        ("x1,x2,u1,u2\n1,2,True,4\n", "no finite number"),
        ("x1,x2,u1,u2\n1,2,1e999,4\n", "no finite number"),
        ("x1,x2,u1,u2\n1,2,\0,4\n", "no finite number|cannot be read"),
    ],
)
def test_tables_that_would_be_misread(tmp_path, text, message):
    (tmp_path / "b.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        io.read_bubbles(tmp_path / "b.csv")


@pytest.mark.parametrize(
    "text",
    [
        "a: \0",
        "[" * 5000,
        "a: 2001-99-99",
        "a: " + "9" * 5000,
        "? [a]\n: b",
        "a: !!float x",
        "x" * (2 << 20),
    ]
    + ["{" * 3000 + "a: 1" + "}" * 3000, "a: &a [*a]\n b: c", "- 1", "1: 2"],
)
def test_settings_that_are_none(tmp_path, text):
    (tmp_path / "s.yaml").write_text(text)
    with pytest.raises(InputError, match=r"s\.yaml: ") as caught:
        io.read_settings(tmp_path / "s.yaml")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600
