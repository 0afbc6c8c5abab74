"""Where files are written: complete or not at all, together, and over nothing that matters."""

import os
import signal
import stat
import threading

import numpy as np
import pandas as pd
import pytest

from eofm import io
from eofm.errors import InputError


def test_files_written_together_appear_as_one(tmp_path):
    names = ["a.tif", "b.tif"]
    with io.together():
        for name in names:
            io.write_image(tmp_path / name, np.eye(4))
            assert not (tmp_path / name).exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == names


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, OSError])
def test_of_files_written_together_none_appears_after_an_error(tmp_path, error):
    io.write_image(tmp_path / "a.tif", np.eye(4))
    before = (tmp_path / "a.tif").read_bytes()

    def fail_at_the_second():
        with io.together():
            io.write_image(tmp_path / "a.tif", 2 * np.eye(4))
            io.remove(tmp_path / "a.tif")
            io.write_image(tmp_path / "b.tif", np.eye(4))
            raise error

    with pytest.raises(error):
        fail_at_the_second()
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]
    assert (tmp_path / "a.tif").read_bytes() == before


def test_a_signal_waits_until_all_files_are_in_place(tmp_path, monkeypatch):
    caught = []
    before = signal.signal(signal.SIGINT, lambda *_: caught.append(len(list(tmp_path.iterdir()))))
    replace = type(tmp_path).replace

    def interrupted(self, target):
        os.kill(os.getpid(), signal.SIGINT)
        return replace(self, target)

    monkeypatch.setattr(type(tmp_path), "replace", interrupted)
    # The system may hand a signal to any thread, such as those of compiled loops.
    end = threading.Event()
    threading.Thread(target=end.wait).start()
    try:
        with io.together():
            for k in range(3):
                io.write_image(tmp_path / f"{k}.tif", np.eye(4))
    finally:
        end.set()
        signal.signal(signal.SIGINT, before)
    assert caught
    assert set(caught) == {3}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["0.tif", "1.tif", "2.tif"]


def test_a_symbolic_link_stays_and_its_file_is_replaced(tmp_path):
    (tmp_path / "far").mkdir()
    link = tmp_path / "u.tif"
    link.symlink_to(tmp_path / "far" / "u.tif")
    io.write_image(link, np.eye(4))
    assert link.is_symlink()
    np.testing.assert_array_equal(io.read_image(tmp_path / "far" / "u.tif"), np.eye(4))


def test_devices_and_pipes_stay(tmp_path):
    os.mkfifo(tmp_path / "pipe.tif")
    with pytest.raises(InputError, match="is no regular file"):
        io.write_image(tmp_path / "pipe.tif", np.eye(4))
    assert stat.S_ISFIFO((tmp_path / "pipe.tif").stat().st_mode)


def test_a_write_protected_file_stays_even_for_root(tmp_path):
    path = tmp_path / "u.tif"
    path.write_text("kept")
    path.chmod(0o444)
    with pytest.raises(InputError, match="is write-protected"):
        io.write_image(path, np.eye(4))
    assert path.read_text() == "kept"


@pytest.mark.parametrize("name", ["u.npy", "u.png", "u.csv", "u.dat"])
def test_a_tiff_has_no_other_format_s_name(tmp_path, name):
    with pytest.raises(InputError, match=rf"to hold TIFF but its name ends in \{name[1:]}"):
        io.write_image(tmp_path / name, np.eye(4))
    io.write_image(tmp_path / "u", np.eye(4))
    assert [p.name for p in tmp_path.iterdir()] == ["u"]


def test_a_full_disk_names_the_file(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tifffile.imwrite", full)
    with pytest.raises(OSError, match=r"u.tif: cannot be written \(No space left"):
        io.write_image(tmp_path / "u.tif", np.eye(4))
    assert not list(tmp_path.iterdir())


def test_a_folder_that_takes_no_file_is_told_once(tmp_path, monkeypatch):
    """Whom the folder does not let write, though it looked as if it did."""

    def denied(*_, **__):
        raise OSError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkstemp", denied)
    told = rf"^{tmp_path}/u.tif: cannot be written \(Permission denied\)$"
    with pytest.raises(OSError, match=told):
        io.write_image(tmp_path / "u.tif", np.eye(4))


def test_files_may_be_named_by_words(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    I, u = np.arange(600.0).reshape(20, 30) / 600, np.zeros((2, 20, 30))
    io.write_image("image.tif", I)
    io.write_field("field.tif", u)
    io.write_table("table.csv", pd.DataFrame({"a": [1.0]}))
    io.write_json("settings.json", {"a": 1})
    io.write_vti("grid.vti", {"u": u}, (1.0, 1.0))
    np.testing.assert_allclose(io.read_image("image.tif"), I, atol=1e-6)
    np.testing.assert_array_equal(io.read_field("field.tif"), u)
    assert io.read_columns("table.csv", ("a",)).a.tolist() == [1.0]
    assert io.read_settings("settings.json") == {"a": 1}
    assert sorted(p.name for p in tmp_path.glob("*.vti")) == ["grid.vti"]
