"""What results come from, and that what was written is what is read."""

import hashlib
import json

import numpy as np
import pandas as pd
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from eofm import io
from eofm.errors import InputError

SETTINGS = {"pair": {"reference": "/home/me/scans/a.tif", "top": "moved /home/me/top.csv"}}


def made(folder, run):
    """A field made from an input in a folder, by a recorded step."""
    (folder / run).mkdir()
    io.write_image(folder / run / "a.tif", np.eye(9))
    with io.Origin("estimate", SETTINGS).recorded():
        I = io.read_image(folder / run / "a.tif")
        io.write_field(folder / run / "u.tif", np.stack([I, I]))
    return folder / run / "u.tif"


def test_a_field_says_what_it_comes_from_but_not_where_and_when(tmp_path):
    first, second = made(tmp_path, "here"), made(tmp_path, "there")
    assert first.read_bytes() == second.read_bytes()
    with tifffile.TiffFile(first) as file:
        said = json.loads(file.imagej_metadata["Info"])
    assert said["step"] == "estimate"
    assert said["settings"] == {"pair": {"reference": "a.tif", "top": "moved top.csv"}}
    digest = hashlib.sha256((first.parent / "a.tif").read_bytes()).hexdigest()
    assert said["inputs"] == [{"file": "a.tif", "sha256": digest}]
    assert "/home" not in json.dumps(said)


@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_changed_byte_of_a_field_is_found(tmp_path_factory, place, bit):
    path = tmp_path_factory.mktemp("changed") / "u.tif"
    io.write_field(path, np.random.default_rng(0).normal(size=(2, 9, 12)))
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        start = file.pages[0].dataoffsets[0]
    data[start + int(place * 2 * 9 * 12 * 4)] ^= 1 << bit
    path.write_bytes(data)
    with pytest.raises(InputError, match="is not what was written"):
        io.read_field(path)


def test_a_changed_table_is_found_unless_the_change_is_meant(tmp_path):
    path = tmp_path / "bubbles.csv"
    io.write_table(path, pd.DataFrame({"x1": [1.0], "x2": [2.0], "u1": [0.0], "u2": [3.0]}))
    assert io.read_bubbles(path).u2[0] == 3
    path.write_text(path.read_text().replace("3.", "4."))
    with pytest.raises(InputError, match=r"is not what was written .*delete bubbles.csv.sha256"):
        io.read_bubbles(path)
    (tmp_path / "bubbles.csv.sha256").unlink()
    assert io.read_bubbles(path).u2[0] == 4


def test_the_checksum_of_a_table_is_that_of_sha256sum(tmp_path):
    path = tmp_path / "t.csv"
    io.write_table(path, pd.DataFrame({"x": [1.0]}))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert (tmp_path / "t.csv.sha256").read_text() == f"{digest}  t.csv\n"


def test_an_input_that_is_replaced_during_the_run_ends_it(tmp_path):
    io.write_image(tmp_path / "a.tif", np.eye(9))

    def run():
        with io.together(), io.Origin("estimate", {}).recorded():
            I = io.read_image(tmp_path / "a.tif")
            io.write_image(tmp_path / "a.tif.new.tif", I)
            (tmp_path / "a.tif").write_bytes(b"another")

    with pytest.raises(InputError, match=r"a.tif: changed while it was used"):
        run()
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]


def test_no_step_writes_over_what_it_has_read(tmp_path):
    io.write_image(tmp_path / "a.tif", np.eye(9))
    with io.Origin("estimate", {}).recorded():
        I = io.read_image(tmp_path / "a.tif")
        with pytest.raises(InputError, match="is read; name another file"):
            io.write_image(tmp_path / "." / "a.tif", I)
