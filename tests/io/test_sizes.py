"""The size of pixels: as files state it, as it is written, and who wins."""

import h5py
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

import eofm
from eofm import io
from eofm.app.cli import main
from eofm.errors import InputError
from eofm.io.scan import micrometres

I = np.random.default_rng(1).normal(size=(20, 30)).astype(np.float32)
V = np.random.default_rng(1).normal(size=(9, 20, 30)).astype(np.float32)
side = st.floats(1e-6, 1e9)


@given(sides=st.tuples(side, side, side))
def test_what_is_written_is_read(tmp_path_factory, sides):
    folder = tmp_path_factory.mktemp("sizes")
    io.write_image(folder / "V.tif", V, sides)
    io.write_image(folder / "I.tif", I, sides[:2])
    read = io.read_scan(folder / "V.tif").sizes
    assert [read[axis] for axis in "XYZ"] == pytest.approx(sides, rel=1e-8)
    read = io.read_scan(folder / "I.tif").sizes
    assert [read[axis] for axis in "XY"] == pytest.approx(sides[:2], rel=1e-8)


def test_no_size_no_change(tmp_path):
    """Where no size is known, files are those that they always were."""
    io.write_image(tmp_path / "I.tif", I)
    assert not io.read_scan(tmp_path / "I.tif").sizes
    with tifffile.TiffFile(tmp_path / "I.tif") as file:
        assert "unit" not in file.imagej_metadata


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("um", 1), ("micron", 1), ("\\u00B5m", 1), ("mm", 1000), ("nm", 1e-3), ("cm", 1e4)],
)
def test_imagej(tmp_path, unit, factor):
    tifffile.imwrite(
        tmp_path / "V.tif",
        V,
        imagej=True,
        resolution=(1 / 2.5, 1 / 0.5),
        metadata={"axes": "ZYX", "unit": unit, "spacing": 4.0},
    )
    read = io.read_scan(tmp_path / "V.tif").sizes
    assert read == pytest.approx({"X": 2.5 * factor, "Y": 0.5 * factor, "Z": 4 * factor})
    page = io.read_scan(f"{tmp_path / 'V.tif'}#3")
    assert page.sizes["X"] == pytest.approx(2.5 * factor)


def test_imagej_leaves_out_a_spacing_of_one(tmp_path):
    metadata = {"axes": "ZYX", "unit": "mm"}
    tifffile.imwrite(tmp_path / "V.tif", V, imagej=True, resolution=(2, 2), metadata=metadata)
    assert io.read_scan(tmp_path / "V.tif").sizes == {"X": 500, "Y": 500, "Z": 1000}


@pytest.mark.parametrize("more", [{"imagej": True, "metadata": {"unit": "inch"}}, {}])
def test_dots_to_the_inch_are_for_printers(tmp_path, more):
    tifffile.imwrite(tmp_path / "I.tif", I, resolution=(72, 72), **more)
    assert not io.read_scan(tmp_path / "I.tif").sizes


@pytest.mark.parametrize("unit", ["\N{MICRO SIGN}m", "mm", None])
def test_ome(tmp_path, unit):
    said = {"axes": "ZYX", "PhysicalSizeX": 2.5, "PhysicalSizeY": 0.5, "PhysicalSizeZ": 4.0}
    said |= {f"PhysicalSize{a}Unit": unit for a in "XYZ" if unit}
    tifffile.imwrite(tmp_path / "V.tif", V, ome=True, metadata=said)
    factor = 1000 if unit == "mm" else 1
    expected = {"X": 2.5 * factor, "Y": 0.5 * factor, "Z": 4 * factor}
    assert io.read_scan(tmp_path / "V.tif").sizes == pytest.approx(expected)


def test_hdf5(tmp_path):
    with h5py.File(tmp_path / "V.h5", "w") as file:
        file["V"] = V
        file["V"].attrs["element_size_um"] = (4.0, 0.5, 2.5)
    assert io.read_scan(tmp_path / "V.h5").sizes == {"X": 2.5, "Y": 0.5, "Z": 4.0}


@given(value=st.one_of(st.floats(), st.text(max_size=9), st.none()), unit=st.text(max_size=9))
def test_what_is_no_size_is_left_out(value, unit):
    for found in (micrometres({"X": value}, unit), micrometres({"X": value}, "um")):
        assert all(1e-6 <= size <= 1e9 for size in found.values())


def scans(**sizes):
    return {name: io.Scan(I, "YX", said) for name, said in sizes.items()}


def test_what_the_user_gives_wins(caplog):
    caplog.set_level("INFO")
    files = scans(a={"X": 2.0, "Y": 3.0}, b={"X": 9.0, "Y": 3.00001})
    assert io.pixel_size(files, 2, (5.0, 6.0)) == ((5.0, 6.0), "lateral_size, axial_size")
    assert not caplog.messages
    assert io.pixel_size(files, 2, (5.0, None, 7.0)) == ((5.0, 3.0), "lateral_size, a")
    assert caplog.messages == ["pixels of 5 x 3 um, from lateral_size, a"]
    with pytest.raises(InputError, match="lateral_size: is 2 um in a but 9 um in b; say which"):
        io.pixel_size(files, 2)
    assert io.pixel_size(scans(a={}, b={"X": 1.0, "Y": 1.0}), 2) == ((1.0, 1.0), "b")
    assert io.pixel_size(scans(a={}, b={}), 3) is None


def test_half_a_size_is_none():
    with pytest.raises(InputError, match=r"axial_size: is not known, .*from lateral_size"):
        io.pixel_size(scans(a={}), 2, (5.0,))
    with pytest.raises(InputError, match=r"elevational_size: is not known, .*from a"):
        io.pixel_size(scans(a={"X": 2.0, "Y": 3.0}), 3)


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A pair of which the files state the size of a pixel."""
    u = np.zeros((2, 60, 80))
    u[1] = -0.02 * np.arange(60)[:, None]
    for name, image in zip("ab", eofm.make_phantom(u, eofm.Phantom(seed=2))[:2], strict=True):
        io.write_image(tmp_path / f"{name}.tif", image, (4.0, 2.5))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_results_of_the_command_have_the_size_of_the_images(files, capsys):
    words = ["estimate", "a.tif", "b.tif", "--output", "u.tif", "--deviation", "d.tif"]
    assert main(words) == 0
    assert "eofm estimate: pixels of 4 x 2.5 um, from a.tif\n" in capsys.readouterr().err
    for name, label in (("u", "u1 lateral [px]"), ("d", "deviation of u1 lateral [px]")):
        with tifffile.TiffFile(files / f"{name}.tif") as file:
            assert file.pages[0].tags["XResolution"].value == (1, 4)
            assert file.imagej_metadata["unit"] == "um"
            assert file.imagej_metadata["Labels"][0] == label
    assert main([*words, "--lateral-size", "3", "--axial-size", "3"]) == 0
    assert "pixels" not in capsys.readouterr().err
    with tifffile.TiffFile(files / "u.tif") as file:
        assert file.pages[0].tags["XResolution"].value == (1, 3)


def test_a_scene_has_the_size_of_its_images(files, caplog):
    caplog.set_level("INFO")
    scene = eofm.read_scene(eofm.Pair(reference="a.tif", deformed="b.tif", bottom="moved 0 -5 um"))
    assert scene.pixel_size == ((4.0, 2.5), "a.tif")
    assert scene.known.pixel_size == (4.0, 2.5)
    np.testing.assert_array_equal(scene.known.edges["bottom"], [[0], [-2]])
    assert caplog.messages == ["pixels of 4 x 2.5 um, from a.tif"]


def test_an_edge_in_um_wants_a_size(files):
    for name in "ab":
        io.write_image(files / f"{name}.tif", io.read_image(files / f"{name}.tif"))
    pair = eofm.Pair(reference="a.tif", deformed="b.tif", bottom="moved 0 -5 um")
    with pytest.raises(InputError, match="bottom: moves in um, but the size of a pixel is not"):
        eofm.read_scene(pair)
    scene = eofm.read_scene(pair.changed(bottom="moved 0 -2"))
    assert (scene.pixel_size, scene.known.pixel_size) == (None, (1.0, 1.0))
