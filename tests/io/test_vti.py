"""Files for ParaView."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from eofm import io
from eofm.errors import InputError


def read(path):
    """What stands in a file, by the format's description, and not by the code that wrote it."""
    data = path.read_bytes()
    text, mark, values = data.partition(b'<AppendedData encoding="raw">\n_')
    assert mark
    root = ElementTree.fromstring(text + b"<AppendedData/></VTKFile>")
    assert root.attrib["byte_order"] == "LittleEndian"
    image = root.find("ImageData")
    ends = [int(word) for word in image.attrib["WholeExtent"].split()]
    assert image.find("Piece").attrib["Extent"] == image.attrib["WholeExtent"]
    assert ends[::2] == [0, 0, 0]
    shape = [n + 1 for n in ends[:0:-2]]
    arrays = {}
    for each in image.findall("Piece/PointData/DataArray"):
        at, count = int(each.attrib["offset"]), int(each.attrib["NumberOfComponents"])
        size = int.from_bytes(values[at : at + 8], "little")
        flat = np.frombuffer(values[at + 8 : at + 8 + size], "<f4")
        arrays[each.attrib["Name"]] = flat.reshape(*shape, count)
    assert values.endswith(b"\n</AppendedData>\n</VTKFile>\n")
    return arrays, [float(word) for word in image.attrib["Spacing"].split()], text.decode()


side = st.floats(1e-3, 1e3)
grids = hnp.array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=6)


@given(shape=grids, sides=st.tuples(side, side, side), seed=st.integers(0, 99))
def test_what_is_written_is_there(tmp_path_factory, shape, sides, seed):
    rng, ndim = np.random.default_rng(seed), len(shape)
    u = rng.normal(size=(ndim, *shape))
    strain = rng.normal(size=(3 if ndim == 2 else 6, *shape)).astype(np.float32)
    share = rng.normal(size=shape)
    path = tmp_path_factory.mktemp("vti") / "u.vti"
    arrays = {"displacement": u, 'strain "<&>"': strain, "share": share}
    io.write_vti(path, arrays, sides[:ndim])
    found, spacing, _ = read(path)
    assert spacing == [*sides[:ndim], 1.0, 1.0][:3]
    grid = (1, *shape)[-3:]
    assert list(found) == list(arrays)
    for name, values in arrays.items():
        expected = values if values.ndim > ndim else values[None]
        for c, component in enumerate(expected):
            np.testing.assert_array_equal(
                found[name][..., c], component.astype(np.float32).reshape(grid)
            )
    if ndim == 2:
        assert found["displacement"].shape[-1] == 3
        assert not found["displacement"][..., 2].any()
    before = path.read_bytes()
    io.write_vti(path, arrays, sides[:ndim])
    assert path.read_bytes() == before


def test_components_have_names_and_the_file_its_origin(tmp_path):
    e = np.zeros((3, 4, 5))
    with io.Origin("sample", {"pair": {"top": "fixed"}}).recorded():
        io.write_vti(tmp_path / "e.vti", {"e": e}, (1, 1), {"e": ["e11", "e22", "e12"]})
    found, _, text = read(tmp_path / "e.vti")
    assert found["e"].shape == (1, 4, 5, 3)
    assert 'ComponentName0="e11" ComponentName1="e22" ComponentName2="e12"' in text
    codes = re.search(r'Name="provenance"[^>]*>([^<]*) 0</Array>', text)[1]
    assert bytes(int(code) for code in codes.split()).startswith(b'{"eofm": ')


def test_what_is_on_no_grid_is_refused(tmp_path):
    path = tmp_path / "u.vti"
    with pytest.raises(ValueError, match="no common grid"):
        io.write_vti(path, {"a": np.zeros((4, 5)), "b": np.zeros((2, 4, 6))}, (1, 1))
    with pytest.raises(ValueError, match="on no grid with 3 axes"):
        io.write_vti(path, {"a": np.zeros((4, 5))}, (1, 1, 1))
    with pytest.raises(InputError, match=r"its name ends in .tif; use .vti"):
        io.write_vti(tmp_path / "u.tif", {"a": np.zeros((4, 5))}, (1, 1))
    assert not list(tmp_path.iterdir())


def test_vtk_reads_it(tmp_path):
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    rng = np.random.default_rng(0)
    u, share = rng.normal(size=(3, 4, 5, 6)), rng.normal(size=(4, 5, 6))
    with io.Origin("sample", {}).recorded():
        io.write_vti(tmp_path / "u.vti", {"u": u, "share": share}, (2.0, 3.0, 4.0))
    reader = vtk.vtkXMLImageDataReader()
    reader.SetFileName(str(tmp_path / "u.vti"))
    reader.Update()
    image = reader.GetOutput()
    assert image.GetDimensions() == (6, 5, 4)
    assert image.GetSpacing() == (2.0, 3.0, 4.0)
    read = vtk_to_numpy(image.GetPointData().GetArray("u")).reshape(4, 5, 6, 3)
    np.testing.assert_allclose(read, np.moveaxis(u, 0, -1), rtol=1e-6)
    read = vtk_to_numpy(image.GetPointData().GetArray("share")).reshape(4, 5, 6)
    np.testing.assert_allclose(read, share, rtol=1e-6)
    assert image.GetFieldData().GetAbstractArray("provenance").GetValue(0).startswith('{"eofm"')
