"""Volumes in and out: which axis is which, in every format, and what is no volume."""

import h5py
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.io import savemat

from eofm import io
from eofm.errors import InputError
from eofm.io.formats import read_array
from eofm.io.tiff import write_tiff

V = np.random.default_rng(0).normal(size=(9, 10, 11)).astype(np.float32)


def written(folder, kind):
    """A volume in a file of a kind."""
    path = folder / f"V.{kind.partition(' ')[0]}"
    if kind == "tif pages":
        tifffile.imwrite(path, V)
    elif kind == "tif bare":
        tifffile.imwrite(path, V, metadata=None, bigtiff=True, byteorder=">")
    elif kind == "tif imagej":
        tifffile.imwrite(path, V, imagej=True, metadata={"axes": "ZYX"})
    elif kind == "tif ome":
        tifffile.imwrite(path, V[:, None], ome=True, metadata={"axes": "ZCYX"})
    elif kind == "tif ours":
        io.write_image(path, V)
    elif kind == "npy":
        np.save(path, V)
    elif kind == "npz":
        np.savez_compressed(path, V=V)
    elif kind == "mat":  # rows, columns, pages
        savemat(path, {"V": np.moveaxis(V, 0, -1)})
    elif kind == "mat hdf5":
        with h5py.File(path, "w") as file:
            file["V"] = np.moveaxis(V, 0, -1).T
    elif kind == "h5":
        with h5py.File(path, "w") as file:
            file["scan/V"] = V
    return path


KINDS = ["tif pages", "tif bare", "tif imagej", "tif ome", "tif ours", "npy", "npz", "mat"]
KINDS += ["mat hdf5", "h5"]


@pytest.mark.parametrize("kind", KINDS)
def test_volumes_are_read_in_single_precision(tmp_path, kind):
    read = io.read_image(written(tmp_path, kind))
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, V)


def test_a_page_of_a_volume_is_an_image(tmp_path):
    page = io.read_image(f"{written(tmp_path, 'tif imagej')}#4")
    assert page.dtype == np.float64
    np.testing.assert_array_equal(page, V[4])
    np.testing.assert_array_equal(io.read_image(f"{written(tmp_path, 'h5')}#scan/V#4"), V[4])


def test_axes_along_which_there_is_nothing_are_none(tmp_path):
    np.save(tmp_path / "I.npy", V[:1])
    assert io.read_image(tmp_path / "I.npy", 2).shape == (10, 11)
    tifffile.imwrite(tmp_path / "I.tif", V[None, :, None], ome=True, metadata={"axes": "TZCYX"})
    assert io.read_image(tmp_path / "I.tif", 3).shape == V.shape


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ("TYX", r"its 9 pages are times \(T\), no slices; name one, as in .*#0, give .* frames"),
        ("CYX", "holds 9 channels; save one image or volume"),
        ("TZYX", "holds 2 times, 9 slices; save one"),
        ("ZCYX", "holds 9 slices, 2 channels; save one"),
    ],
)
@pytest.mark.parametrize("kind", ["imagej", "ome"])
def test_times_and_channels_are_no_volumes(tmp_path, axes, message, kind):
    values = V if len(axes) == 3 else np.stack([V, V], axis=axes.index("TC"[axes[0] == "Z"]))
    tifffile.imwrite(tmp_path / "V.tif", values, **{kind: True}, metadata={"axes": axes})
    with pytest.raises(InputError, match=message) as caught:
        io.read_image(tmp_path / "V.tif")
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="where an image is wanted; name a page"):
        io.read_image(tmp_path / "V.tif", 2)


def test_a_stack_is_what_the_user_says(tmp_path, caplog):
    """The same pages are frames or slices; what the file says otherwise is told."""
    np.save(tmp_path / "V.npy", V)
    frames = io.read_stack(tmp_path / "V.npy").values
    assert frames.dtype == np.float64
    np.testing.assert_array_equal(frames, V)
    assert not caplog.messages
    io.read_stack(written(tmp_path, "tif imagej"))
    assert [m.partition("V.tif")[2] for m in caplog.messages] == [
        ": slices (Z) are taken for frames"
    ]


def test_volumes_and_images_are_not_taken_for_each_other(tmp_path):
    np.save(tmp_path / "V.npy", V)
    np.save(tmp_path / "I.npy", V[0])
    np.save(tmp_path / "W.npy", V[1:])
    for first, second, message in (
        ("V", "I", "I.npy: has 10 x 11 px but .*V.npy has 9 x 10 x 11 px"),
        ("V", "W", "W.npy: has 8 x 10 x 11 px but .*V.npy has 9 x 10 x 11 px"),
    ):
        with pytest.raises(InputError, match=message):
            io.read_pair(tmp_path / f"{first}.npy", tmp_path / f"{second}.npy")
    with pytest.raises(InputError, match=r"I.npy: is an image where a volume is wanted"):
        io.read_image(tmp_path / "I.npy", 3)
    with pytest.raises(InputError, match=r"stack of shape .* where an image is wanted"):
        io.read_pair(tmp_path / "V.npy", tmp_path / "V.npy", ndim=2)
    np.save(tmp_path / "thin.npy", V[:4])
    with pytest.raises(InputError, match="has 4 x 10 x 11 px; at least 8 x 8 x 8 are needed"):
        io.read_pair(tmp_path / "thin.npy", tmp_path / "thin.npy")


def test_a_volume_with_a_hole_is_refused_by_its_place(tmp_path):
    bad = V.astype(np.float64)
    bad[3, 4, 5] = 1e300  # finite as it is, not in single precision
    np.save(tmp_path / "V.npy", bad)
    with pytest.raises(InputError, match=r"1 values are .* at slice 3, row 4, column 5"):
        io.read_image(tmp_path / "V.npy")


@given(u=hnp.arrays(np.float32, (3, 4, 5, 6), elements=st.floats(-1e3, 1e3, width=32)))
@settings(max_examples=20)
def test_fields_of_volumes_survive_the_round_trip(tmp_path_factory, u):
    path = tmp_path_factory.mktemp("field") / "u.tif"
    io.write_field(path, u, sides=(3.9, 6.0, 12.5))
    read = io.read_field(path)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, u)
    before = path.read_bytes()
    io.write_field(path, u, sides=(3.9, 6.0, 12.5))
    assert path.read_bytes() == before


def test_fields_of_volumes_are_hyperstacks(tmp_path):
    io.write_field(tmp_path / "u.tif", np.zeros((3, 4, 5, 6)), sides=(3.9, 6.0, 12.5))
    with tifffile.TiffFile(tmp_path / "u.tif") as file:
        assert (file.series[0].axes, file.series[0].shape) == ("ZCYX", (4, 3, 5, 6))
        said = file.imagej_metadata
        assert (said["slices"], said["channels"], said["hyperstack"]) == (4, 3, True)
        assert (said["unit"], said["spacing"]) == ("um", 12.5)
        names = ["u1 lateral [px]", "u2 axial [px]", "u3 elevational [px]"]
        assert said["Labels"] == names * 4
        assert file.pages[0].tags["XResolution"].value == (10, 39)
        start = file.pages[0].dataoffsets[0]
    data = bytearray((tmp_path / "u.tif").read_bytes())
    data[start + 100] ^= 1
    (tmp_path / "u.tif").write_bytes(data)
    with pytest.raises(InputError, match="is not what was written"):
        io.read_field(tmp_path / "u.tif")


def test_fields_of_images_and_volumes_are_not_taken_for_each_other(tmp_path):
    np.save(tmp_path / "u.npy", np.zeros((3, 4, 5, 6)))
    np.save(tmp_path / "v.npy", np.zeros((2, 5, 6)))
    np.save(tmp_path / "w.npy", np.zeros((2, 4, 5, 6)))
    assert io.read_field(tmp_path / "u.npy", (4, 5, 6)).shape == (3, 4, 5, 6)
    with pytest.raises(InputError, match="field of a volume where that of an image is wanted"):
        io.read_field(tmp_path / "u.npy", ndim=2)
    with pytest.raises(InputError, match="has 5 x 6 px but the images have 4 x 5 x 6 px"):
        io.read_field(tmp_path / "v.npy", (4, 5, 6))
    with pytest.raises(InputError, match=r"no displacement field; .* found shape \(2, 4, 5, 6\)"):
        io.read_field(tmp_path / "w.npy")


def test_a_volume_that_is_too_large_is_refused_by_its_header(tmp_path):
    for kind in ("tif imagej", "npy", "mat", "h5"):
        path = written(tmp_path, kind)
        io.limit_size(V.size * 8 / 2**30 * 0.99)
        try:
            with pytest.raises(InputError, match=r"more than the .* allowed; crop it, or allow"):
                io.read_image(path)
        finally:
            io.limit_size(None)


@pytest.mark.parametrize("labels", [None, ["u1", "u2", "u3"]])
def test_slices_make_the_same_file_as_all_at_once(tmp_path, labels, monkeypatch):
    shape = (5, 3, 9, 11) if labels else (5, 9, 11)
    V = np.random.default_rng(3).random(shape).astype(np.float32)
    write_tiff(tmp_path / "whole.tif", V, labels, (2.0, 3.0, 4.0))
    io.write_slices(tmp_path / "slices.tif", iter(V), shape, labels, (2.0, 3.0, 4.0))
    assert (tmp_path / "whole.tif").read_bytes() == (tmp_path / "slices.tif").read_bytes()
    # Beyond 4 GB.
    monkeypatch.setattr("eofm.io.tiff.CLASSIC", 0)
    io.write_slices(tmp_path / "large.tif", iter(V), shape, labels)
    assert (tmp_path / "large.tif").read_bytes()[2] == 43
    scan = read_array(tmp_path / "large.tif")
    assert scan.axes == ("ZCYX" if labels else "ZYX")
    np.testing.assert_array_equal(scan.values, V)
