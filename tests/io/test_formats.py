"""Formats that labs have: values, axes and sizes as their own libraries write them."""

import json

import h5py
import nibabel
import numpy as np
import pydicom
import pytest
import tifffile
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from made import write_dicom, write_mha, write_nrrd, write_oct, write_zarr
from PIL import Image
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, RLELossless
from scipy.io import savemat

from eofm import io
from eofm.errors import InputError
from eofm.io import formats

V = np.random.default_rng(0).normal(size=(8, 9, 10)).astype(np.float32)
SIZES = {"X": 2.5, "Y": 4.0, "Z": 12.0}


def written(folder, kind):
    """The volume in a file of a kind, with its sizes."""
    kind, _, how = kind.partition(" ")
    path = folder / f"V.{kind}"
    mm = " ".join(str(SIZES[a] / 1000) for a in "XYZ")
    if kind == "tif":
        io.write_image(path, V, (2.5, 4.0, 12.0))
    elif kind == "h5":
        with h5py.File(path, "w") as file:
            file["V"] = V
            file["V"].attrs["element_size_um"] = (12.0, 4.0, 2.5)
    elif kind == "zarr":
        write_zarr(path, V, int(how))
    elif kind.startswith("nii"):
        make = nibabel.Nifti2Image if how == "2" else nibabel.Nifti1Image
        image = make(V.T, np.diag([2.5, 4.0, 12.0, 1.0]))
        image.header.set_xyzt_units("micron")
        nibabel.save(image, path)
    elif kind == "mha":
        write_mha(path, V.astype(">f4") if how == "big" else V, mm, packed=how == "packed")
    elif kind == "nrrd":
        spaced = f'spacings: {mm}\nunits: "mm" "mm" "mm"\n'
        turned = (
            "space: left-posterior-superior\nspace directions: (.0025,0,0) (0,0,.004) (0,.012,0)\n"
        )
        write_nrrd(path, V, how == "packed", turned if how == "turned" else spaced)
    elif kind == "oct":
        write_oct(path, {"Intensity": (V, "Real")}, "/" if how else "\\")
    return path


KINDS = ["tif", "h5", "zarr 2", "zarr 3", "nii", "nii 2", "nii.gz", "mha", "mha big", "mha packed"]
KINDS += ["nrrd", "nrrd packed", "nrrd turned", "oct", "oct linux"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_volume_has_its_values_and_sizes(tmp_path, kind):
    scan = io.read_scan(written(tmp_path, kind))
    np.testing.assert_array_equal(scan.values, V)
    assert scan.sizes == pytest.approx(SIZES)


@pytest.mark.parametrize("kind", ["mha", "nrrd", "oct", "nii", "zarr 3"])
def test_a_file_that_is_cut_off_is_refused(tmp_path, kind):
    path = written(tmp_path, kind)
    if path.is_dir():
        path = path / "0/c/0/0/0"
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match=r"V\.\w+: cannot be read as") as caught:
        io.read_image(tmp_path / f"V.{kind.partition(' ')[0]}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["mha", "nrrd", "oct", "nii", "zarr 2"])
def test_a_file_that_is_too_large_is_refused(tmp_path, kind):
    path = written(tmp_path, kind)
    io.limit_size(V.size * 8 / 2**30 * 0.99)
    try:
        with pytest.raises(InputError, match=r"more than the .* allowed; crop it"):
            io.read_image(path)
    finally:
        io.limit_size(None)


numbers = st.floats(1e-3, 1e3)


@settings(max_examples=25)
@given(x=numbers, y=numbers, z=numbers, packed=st.booleans())
def test_any_spacing_survives_in_text(tmp_path_factory, x, y, z, packed):
    folder = tmp_path_factory.mktemp("text")
    write_mha(folder / "V.mha", V, f"{x!r} {y!r} {z!r}", packed)
    write_nrrd(
        folder / "V.nrrd", V, packed, f'spacings: {x!r} {y!r} {z!r}\nunits: "um" "um" "um"\n'
    )
    expected = {"X": x, "Y": y, "Z": z}
    assert io.read_scan(folder / "V.nrrd").sizes == pytest.approx(expected)
    if set(expected.values()) != {1.0}:
        expected = {axis: 1000 * side for axis, side in expected.items()}
        assert io.read_scan(folder / "V.mha").sizes == pytest.approx(expected)


def test_spacings_of_one_mm_are_nobodys(tmp_path):
    """ITK and nibabel write them where nothing is known."""
    write_mha(tmp_path / "V.mha", V, "1 1 1")
    nibabel.save(nibabel.Nifti1Image(V.T, np.eye(4)), tmp_path / "V.nii")
    write_nrrd(tmp_path / "V.nrrd", V)
    for kind in ("mha", "nii", "nrrd"):
        assert not io.read_scan(tmp_path / f"V.{kind}").sizes


def test_simpleitk_and_pynrrd_agree(tmp_path):
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(V)
    image.SetSpacing((0.0025, 0.004, 0.012))
    for kind in ("mha", "nrrd"):
        for packed in (False, True):
            sitk.WriteImage(image, str(tmp_path / f"V.{kind}"), packed)
            scan = io.read_scan(tmp_path / f"V.{kind}")
            np.testing.assert_array_equal(scan.values, V)
            assert scan.sizes == pytest.approx(SIZES)


def test_images_of_two_axes(tmp_path):
    I = V[0]
    write_mha(tmp_path / "I.mha", I, "0.002 0.003")
    write_nrrd(tmp_path / "I.nrrd", I)
    write_oct(tmp_path / "I.oct", {"Intensity": (V[:1], "Real")})
    nibabel.save(nibabel.Nifti1Image(V[:1].T, np.eye(4)), tmp_path / "I.nii")
    for kind in ("mha", "nrrd", "oct", "nii"):
        read = io.read_image(tmp_path / f"I.{kind}", 2)
        assert read.dtype == np.float64
        np.testing.assert_array_equal(read, I)


U = (1000 * np.abs(V)).astype(np.uint16)


@pytest.mark.parametrize("syntax", [ExplicitVRLittleEndian, RLELossless])
def test_dicom(tmp_path, syntax):
    spaced = {"PixelSpacing": [0.004, 0.0025], "SpacingBetweenSlices": 0.012}
    write_dicom(tmp_path / "V.dcm", U, syntax, **spaced)
    scan = io.read_scan(tmp_path / "V.dcm")
    np.testing.assert_array_equal(scan.values, U)
    assert scan.sizes == pytest.approx(SIZES)
    write_dicom(tmp_path / "0001.41", U[0], RescaleSlope=2.0, RescaleIntercept=-5.0)
    np.testing.assert_array_equal(io.read_image(tmp_path / "0001.41"), 2.0 * U[0] - 5)


def test_dicom_of_ultrasound_is_a_sequence(tmp_path):
    region = Dataset()
    region.PhysicalDeltaX, region.PhysicalDeltaY = 0.02, 0.03
    region.PhysicalUnitsXDirection = region.PhysicalUnitsYDirection = 3
    more = {"FrameTime": 20.0, "SequenceOfUltrasoundRegions": Sequence([region])}
    write_dicom(tmp_path / "U.dcm", U, **more)
    with pytest.raises(InputError, match=r"its 8 pages are times"):
        io.read_image(tmp_path / "U.dcm")
    scan = io.read_stack(tmp_path / "U.dcm")
    assert scan.values.shape == U.shape
    assert scan.sizes == pytest.approx({"X": 200, "Y": 300})


def test_dicom_of_oct_has_its_sizes_in_groups(tmp_path):
    measures, group = Dataset(), Dataset()
    measures.PixelSpacing, measures.SliceThickness = [0.004, 0.0025], 0.012
    group.PixelMeasuresSequence = Sequence([measures])
    write_dicom(tmp_path / "V.dcm", U, SharedFunctionalGroupsSequence=Sequence([group]))
    assert io.read_scan(tmp_path / "V.dcm").sizes == pytest.approx(SIZES)


def test_zarr(tmp_path):
    write_zarr(tmp_path / "V.zarr", V, 3, "millimeter")
    assert io.read_scan(tmp_path / "V.zarr").sizes == {"X": 2500, "Y": 4000, "Z": 12000}
    page = io.read_scan(f"{tmp_path / 'V.zarr'}#2")  # of the finest level, in any case
    np.testing.assert_array_equal(page.values, V[2])
    zarr.save_array(tmp_path / "plain.zarr", V)
    scan = io.read_scan(f"{tmp_path / 'plain.zarr'}/")
    np.testing.assert_array_equal(scan.values, V)
    assert not scan.sizes
    write_zarr(tmp_path / "C.zarr", np.stack([V, V]), 2, axes="czyx")
    with pytest.raises(InputError, match="holds 2 channels, 8 slices"):
        io.read_image(tmp_path / "C.zarr")
    write_zarr(tmp_path / "T.zarr", V[None, None], 2, axes="tczyx")
    np.testing.assert_array_equal(io.read_image(tmp_path / "T.zarr"), V)
    group = zarr.open_group(tmp_path / "G.zarr", mode="w")
    for name in ("a", "b"):
        group.create_array(f"scan/{name}", data=V)
    np.testing.assert_array_equal(io.read_image(tmp_path / "G.zarr#scan/b"), V)
    with pytest.raises(InputError, match=r"name a variable, .*; it holds scan/a, scan/b"):
        io.read_image(tmp_path / "G.zarr")


def test_a_zarr_is_an_input_with_a_checksum(tmp_path):
    write_zarr(tmp_path / "V.zarr", V, 2)
    digests = []
    for change in (False, True, False):
        if change:
            (tmp_path / "V.zarr/more").write_text("more")
        with io.Origin("estimate", {}).recorded() as origin:
            io.read_image(tmp_path / "V.zarr")
        digests.append(origin.record()["inputs"][0]["sha256"])
    assert digests[0] != digests[1] == digests[2]

    def run():
        with io.Origin("estimate", {}).recorded():
            io.read_image(tmp_path / "V.zarr")
            (tmp_path / "V.zarr/another").write_text("more")

    with pytest.raises(InputError, match=r"V.zarr: changed while it was used"):
        run()


C = (V + 1j * V[::-1]).astype(np.complex64)


@pytest.mark.parametrize("kind", ["tif", "npy", "mat", "mat hdf5", "h5", "zarr", "nii", "oct"])
def test_of_complex_values_it_is_the_amplitude(tmp_path, kind, caplog):
    kind, _, how = kind.partition(" ")
    path = tmp_path / f"V.{kind}"
    if kind == "tif":
        tifffile.imwrite(path, C)
    elif kind == "npy":
        np.save(path, C)
    elif how or kind == "h5":
        pages = np.moveaxis(C, 0, -1).T if how else C
        parts = np.zeros(pages.shape, [("real", "f4"), ("imag", "f4")] if how else np.complex64)
        if how:
            parts["real"], parts["imag"] = pages.real, pages.imag
        with h5py.File(path, "w") as file:
            file["V"] = parts if how else pages
    elif kind == "mat":
        savemat(path, {"V": np.moveaxis(C, 0, -1)})
    elif kind == "zarr":
        zarr.save_array(path, C)
    elif kind == "nii":
        nibabel.save(nibabel.Nifti1Image(C.T, np.eye(4)), path)
    elif kind == "oct":
        write_oct(path, {"Complex": (C, "Complex"), "Spectral0": (V, "Raw")})
    np.testing.assert_allclose(io.read_image(path), np.abs(C), rtol=1e-6)
    assert caplog.messages == [f"{path}: holds complex values; their amplitude is taken"]


def test_thorlabs(tmp_path):
    listed = {"Intensity": (V, "Real"), "Retardation": (2 * V, "Real"), "Spectral0": (V, "Raw")}
    listed |= {"Chirp": (V[:1, :, :1], "Real")}
    write_oct(tmp_path / "V.oct", listed)
    np.testing.assert_array_equal(io.read_image(tmp_path / "V.oct"), V)
    np.testing.assert_array_equal(io.read_image(f"{tmp_path / 'V.oct'}#Retardation#3"), 2 * V[3])
    with pytest.raises(InputError, match=r"name a variable, .* holds Intensity, Retardation$"):
        io.read_image(f"{tmp_path / 'V.oct'}#Chirp")
    write_oct(tmp_path / "V.oct", {"Spectral0": (V, "Raw"), "Chirp": (V[:1, :, :1], "Real")})
    with pytest.raises(InputError, match=r"no image but raw spectra"):
        io.read_image(tmp_path / "V.oct")


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ('<!DOCTYPE a [<!ENTITY a "b">]><Ocity/>', "its header defines entities"),
        ("<Ocity><DataFile", "cannot be read as Thorlabs"),
        ("<Ocity/>", "no image but raw spectra"),
        ('<a><DataFile Type="Real" SizeX="99">data/Intensity.data</DataFile></a>', "is stated"),
        ('<a><DataFile Type="Real" SizeX="-9">data/Intensity.data</DataFile></a>', "raw|SizeX"),
        ('<a><DataFile Type="Real" SizeX="9">data/I.data</DataFile></a>', "there is no data/i"),
        ('<a><DataFile Type="Real" SizeX="x">data/I.data</DataFile></a>', "cannot be read"),
        ('<a><DataFile Type="Real" SizeX="99999999999">data/Intensity.data</DataFile></a>', "asks"),
    ],
)
def test_thorlabs_headers_that_lie(tmp_path, header, message):
    write_oct(tmp_path / "V.oct", {"Intensity": (V[:1, :1], "Real")}, header=header)
    with pytest.raises(InputError, match=message) as caught:
        io.read_image(tmp_path / "V.oct")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("DimSize = 8 9\nElementType = MET_FLOAT\nElementDataFile = V.raw\n", "in another file"),
        ("DimSize = 8 9\nElementType = MET_FLOAT\n", "its header does not end"),
        ("DimSize = 8 9\nElementType = MET_NONE\nElementDataFile = LOCAL\n", "MET_NONE are not"),
        ("DimSize = 8 -9\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n", "its sizes are"),
        ("DimSize = 8 9\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n", "288 bytes are"),
        ("DimSize = 99999 99999\nElementType = MET_INT\nElementDataFile = LOCAL\n", "asks for 74"),
        ("ElementDataFile = LOCAL\n", "cannot be read as MHA"),
        ("", "its header does not end"),
    ],
)
def test_mha_headers_that_lie(tmp_path, text, message):
    (tmp_path / "V.mha").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        io.read_image(tmp_path / "V.mha")
    assert "\n" not in str(caught.value)


def test_nrrd_headers_that_lie(tmp_path):
    for more, message in (("data file: V.raw\n", "in another file"), ("sizes: 9\n", "its sizes")):
        write_nrrd(tmp_path / "V.nrrd", V, more=more)
        with pytest.raises(InputError, match=message):
            io.read_image(tmp_path / "V.nrrd")
    write_nrrd(tmp_path / "V.nrrd", V, encoding="bzip2")
    with pytest.raises(InputError, match="float values as bzip2 are not known here"):
        io.read_image(tmp_path / "V.nrrd")
    write_nrrd(tmp_path / "V.nrrd", V, more="kinds: time domain domain\n")
    with pytest.raises(InputError, match="its axes are YXT; save"):
        io.read_image(tmp_path / "V.nrrd")


def test_greyscale_saved_in_colours_is_read(tmp_path):
    grey = np.stack([U[0].astype(np.uint8)] * 3, axis=-1)
    write_mha(tmp_path / "I.mha", grey[..., 0], more="ElementNumberOfChannels = 1\n")
    text = (tmp_path / "I.mha").read_bytes().partition(b"LOCAL\n")[0].replace(b"= 1\n", b"= 3\n")
    (tmp_path / "I.mha").write_bytes(text + b"LOCAL\n" + grey.tobytes())
    np.testing.assert_array_equal(io.read_image(tmp_path / "I.mha"), grey[..., 0])
    kinds = "kinds: RGB-color domain domain\n"
    write_nrrd(tmp_path / "I.nrrd", grey, more=kinds, kind="uchar")
    np.testing.assert_array_equal(io.read_image(tmp_path / "I.nrrd"), grey[..., 0])
    grey[3, 3, 0] += 1
    write_nrrd(tmp_path / "I.nrrd", grey, more=kinds, kind="uchar")
    with pytest.raises(InputError, match="is a colour image"):
        io.read_image(tmp_path / "I.nrrd")
    stack = np.stack([U.astype(np.uint8)] * 3, axis=-1)
    tifffile.imwrite(tmp_path / "V.tif", stack, photometric="rgb")
    np.testing.assert_array_equal(io.read_image(tmp_path / "V.tif"), stack[..., 0])


@pytest.mark.parametrize("name", ["I.jpg", "I.bmp", "I.txt"])
def test_other_files_are_told_the_formats_known(tmp_path, name):
    Image.fromarray(U[0].astype(np.uint8)).save(tmp_path / "I.bmp")
    (tmp_path / "I.bmp").rename(tmp_path / name)
    with pytest.raises(InputError, match=r"no format known here; those are TIFF, PNG, .* and Thor"):
        io.read_image(tmp_path / name)
    tifffile.imwrite(tmp_path / name, U[0])
    np.testing.assert_array_equal(io.read_image(tmp_path / name), U[0])


@pytest.mark.parametrize(
    ("kind", "extra"), [("zarr", "zarr"), ("nii", "medical"), ("dcm", "medical")]
)
def test_a_missing_package_is_named(tmp_path, monkeypatch, kind, extra):
    monkeypatch.setattr(formats, "installed", lambda library: False)
    (tmp_path / f"V.{kind}").mkdir() if kind == "zarr" else (tmp_path / f"V.{kind}").touch()
    with pytest.raises(InputError, match=rf"pip install 'eofm\[{extra}\]'") as caught:
        io.read_image(tmp_path / f"V.{kind}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["zarr", "nii", "nii.gz", "dcm", "mha", "nrrd", "oct", "h5"])
def test_nonsense_is_refused_in_one_line(tmp_path, kind):
    path = tmp_path / f"V.{kind}"
    if kind == "zarr":
        path.mkdir()
        (path / "zarr.json").write_text(json.dumps({"zarr_format": 3, "node_type": "array"}))
    else:
        path.write_bytes(b"nonsense" * 99)
    with pytest.raises(InputError, match=rf"V.{kind}: cannot be read as") as caught:
        io.read_image(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_pydicom_reads_what_is_written_here(tmp_path):
    """The test's own writer: were it wrong, those above would say nothing."""
    write_dicom(tmp_path / "V.dcm", U)
    np.testing.assert_array_equal(pydicom.dcmread(tmp_path / "V.dcm").pixel_array, U)
