import numpy as np
import pandas as pd
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from eofm import io
from eofm.errors import InputError


@given(u=hnp.arrays(np.float32, (2, 5, 7), elements=st.floats(-1e3, 1e3, width=32)))
@settings(max_examples=20)
def test_fields_survive_the_round_trip(tmp_path_factory, u):
    path = tmp_path_factory.mktemp("field") / "u.tif"
    io.write_field(path, u)
    np.testing.assert_array_equal(io.read_field(path), u)
    np.testing.assert_array_equal(tifffile.imread(path), u)


def test_fields_are_labelled_imagej_stacks(tmp_path):
    io.write_field(tmp_path / "u.tif", np.zeros((2, 5, 7)))
    with tifffile.TiffFile(tmp_path / "u.tif") as file:
        assert file.is_imagej
        assert file.imagej_metadata["Labels"] == ["u1 lateral [px]", "u2 axial [px]"]


def test_writing_twice_gives_the_same_bytes(tmp_path, rng):
    u = rng.normal(size=(2, 6, 8))
    for name in ("a", "b"):
        io.write_field(tmp_path / f"{name}.tif", u)
        io.write_image(tmp_path / f"{name}1.tif", u[0])
        io.write_table(tmp_path / f"{name}.csv", pd.DataFrame(u[0]))
    for kind in (".tif", "1.tif", ".csv"):
        assert (tmp_path / f"a{kind}").read_bytes() == (tmp_path / f"b{kind}").read_bytes()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64, np.int32])
def test_images_of_all_depths(tmp_path, dtype):
    I = np.arange(35).reshape(5, 7).astype(dtype)
    tifffile.imwrite(tmp_path / "I.tif", I)
    np.testing.assert_array_equal(io.read_image(tmp_path / "I.tif"), I)


def written(folder, kind):
    """A file that is no usable image, and what must be said of it."""
    path = folder / f"{kind}.tif"
    I = np.arange(600.0).reshape(20, 30)
    if kind == "missing":
        return path, "no such file"
    if kind == "folder":
        path.mkdir()
        return path, "cannot be read"
    if kind == "text":
        path.write_text("no image")
        return path, "cannot be read as TIFF"
    if kind == "empty":
        path.touch()
        return path, "cannot be read as TIFF"
    if kind == "truncated":
        tifffile.imwrite(path, I)
        path.write_bytes(path.read_bytes()[:2000])
        return path, "cannot be read as TIFF"
    arrays = {
        "nan": (np.where(I == 65, np.nan, I), "1 values are NaN or infinite.*row 2, column 5"),
        "inf": (np.where(I == 65, np.inf, I), "1 values are NaN or infinite"),
        "rgb": (np.eye(3, dtype=np.uint8)[np.eye(20, 30, dtype=int)], "is a colour image"),
        "stack": (np.zeros((5, 20, 30), np.uint8), r"a stack of shape \(5, 20, 30\) where an im"),
    }
    tifffile.imwrite(path, arrays[kind][0])
    return path, arrays[kind][1]


KINDS = ["missing", "folder", "text", "empty", "truncated", "nan", "inf", "rgb", "stack"]


@pytest.mark.parametrize("kind", KINDS)
def test_unusable_images_are_refused_in_one_line(tmp_path, kind):
    path, message = written(tmp_path, kind)
    with pytest.raises(InputError, match=message) as caught:
        io.read_image(path, 2)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_sizes_are_refused(tmp_path):
    for name, shape in (("a", (8, 9)), ("b", (9, 8))):
        tifffile.imwrite(tmp_path / f"{name}.tif", np.eye(*shape))
    with pytest.raises(InputError, match=r"b.tif: has 9 x 8 px but .*a.tif has 8 x 9 px"):
        io.read_pair(tmp_path / "a.tif", tmp_path / "b.tif")


def test_an_image_is_no_field(tmp_path):
    io.write_image(tmp_path / "I.tif", np.eye(6))
    with pytest.raises(InputError, match="no displacement field"):
        io.read_field(tmp_path / "I.tif")


def test_a_field_of_another_size_is_refused(tmp_path):
    io.write_field(tmp_path / "u.tif", np.zeros((2, 6, 8)))
    with pytest.raises(InputError, match="has 6 x 8 px but the images have 6 x 9 px"):
        io.read_field(tmp_path / "u.tif", (6, 9))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "cannot be read as a CSV"),
        ("x1,x2,u1\n1,2,3\n", "lacks the column u2"),
        ("x1,x2,u1,u2\n1,2,3,4\n1,2,?,4\n", "u1 in line 3 is no finite number"),
        ("x1,x2,u1,u2\n1,2,3,inf\n", "u2 in line 2 is no finite number"),
    ],
)
def test_unusable_tables_are_refused(tmp_path, text, message):
    (tmp_path / "b.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        io.read_bubbles(tmp_path / "b.csv")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "I.tif"
    io.write_image(path, np.eye(4))
    before = path.read_bytes()

    def fail_halfway():
        with io.replacing(path) as temporary:
            temporary.write_text("half of it")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_halfway()
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(InputError, match=r"the folder .*nowhere does not exist"):
        io.write_image(tmp_path / "nowhere" / "I.tif", np.eye(4))
