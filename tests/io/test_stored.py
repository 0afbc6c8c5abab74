"""Windows of arrays that stay in their files."""

import numpy as np
import pytest
import tifffile
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from made import write_zarr

from eofm import io
from eofm.errors import InputError

V = np.random.default_rng(0).normal(size=(8, 9, 10)).astype(np.float32)
PART = (slice(2, 7), slice(0, 4), slice(3, 10))


def written(folder, kind):
    path = folder / f"V.{kind.partition(' ')[0]}"
    if kind == "tif":
        io.write_image(path, V, (2.5, 4.0, 12.0))
    elif kind == "tif ome":
        tifffile.imwrite(path, V, ome=True, metadata={"axes": "ZYX"})
    elif kind == "tif big":
        tifffile.imwrite(path, V, bigtiff=True, byteorder=">", photometric="minisblack")
    elif kind == "npy":
        np.save(path, V.astype(">f8"))
    elif kind == "npy one":
        np.save(path, V[None])
    elif kind == "zarr plain":
        zarr.save_array(path, V)
    else:
        write_zarr(path, V, int(kind[-1]))
    return path


KINDS = ["tif", "tif ome", "tif big", "npy", "npy one", "zarr 2", "zarr 3", "zarr plain"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_window_is_that_of_the_whole(tmp_path, kind):
    path = written(tmp_path, kind)
    stored, scan = io.open_stored(path), io.read_scan(path)
    assert stored.shape == V.shape
    assert stored.scan.sizes == scan.sizes
    part = stored.read(PART)
    assert part.dtype == np.float32
    np.testing.assert_array_equal(part, scan.values[PART])


def test_an_image(tmp_path):
    np.save(tmp_path / "I.npy", V[0])
    np.testing.assert_array_equal(io.open_stored(tmp_path / "I.npy").read(PART[1:]), V[0][PART[1:]])


def test_what_no_part_can_be_read_of(tmp_path):
    tifffile.imwrite(tmp_path / "packed.tif", V, compression="zlib")
    tifffile.imwrite(tmp_path / "tiled.tif", V[0], tile=(16, 16))
    np.save(tmp_path / "turned.npy", np.asfortranarray(V))
    (tmp_path / "V.mha").write_text("ObjectType = Image")
    io.write_image(tmp_path / "V.tif", V)
    (tmp_path / "cut.tif").write_bytes((tmp_path / "V.tif").read_bytes()[:-40])
    write_zarr(tmp_path / "C.zarr", np.stack([V, V]), 2, axes="czyx")
    np.save(tmp_path / "nan.npy", np.where(V.max() == V, np.nan, V))
    expected = {
        "packed.tif": "compressed or in tiles",
        "tiled.tif": "compressed or in tiles",
        "turned.npy": "do not lie in rows",
        "V.mha": "only of Zarr, NumPy",
        "V.tif#2": "leave out #2",
        "cut.tif": "cannot be read",
        "nowhere.tif": "no such file",
        "C.zarr": "channels",
        "nan.npy": "NaN",
    }
    for name, message in expected.items():
        with pytest.raises(InputError, match=message) as caught:
            io.open_stored(tmp_path / name).read(tuple(slice(0, n) for n in V.shape))
        assert "\n" not in str(caught.value)


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_what_is_written_in_windows_is_read_in_others(tmp_path_factory, data):
    shape = tuple(data.draw(st.lists(st.integers(1, 7), min_size=2, max_size=4)))
    values = np.random.default_rng(1).random(shape).astype(np.float32)
    path = tmp_path_factory.mktemp("store") / "A.npy"
    window = []
    for n in shape:
        first = data.draw(st.integers(0, n - 1))
        window.append(slice(first, data.draw(st.integers(first + 1, n))))
    window = tuple(window)
    with io.new_store(path, shape) as store:
        for part in io.windows(shape, data.draw(st.integers(1, 50))):
            store.write(part, values[part])
        np.testing.assert_array_equal(store.read(window), values[window])
    with io.open_store(path) as store:
        np.testing.assert_array_equal(store.read(window), values[window])
    np.testing.assert_array_equal(np.load(path), values)
