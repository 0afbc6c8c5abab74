"""Every step of the command ended in the middle, on full disks, in little memory, with damage."""

import itertools
import os
import resource
import shutil
import signal
import subprocess
import sys
from random import Random

import numpy as np
import pytest
import tifffile

from eofm import io
from eofm.app.cli import main
from eofm.errors import InputError
from eofm.io import places

pytestmark = pytest.mark.slow

# A step of each kind, with what it reads in one folder and what it writes in another.
SIZE = ["--height", "24", "--width", "32", "--compression", "1"]
PAIR = ["{0}/a.tif", "{0}/b.tif"]
STEPS = {
    "forward": [*SIZE, "--output", "{1}/true.tif"],
    "background": [*SIZE, "--output", "{1}/bg.tif"],
    "phantom": ["{0}/true.tif", "--reference", "{1}/a.tif", "--deformed", "{1}/b.tif"]
    + ["--table", "{1}/true.csv", "--count", "40"],
    "virtual-oct": ["{0}/true.tif", "{0}/bg.tif", "--reference", "{1}/oct_a.tif"]
    + ["--deformed", "{1}/oct_b.tif", "--truth", "{1}/oct.tif", "--background", "{1}/oct_bg.tif"]
    + ["--reflectors", "20"],
    "track": [*PAIR, "--prediction", "{0}/bg.tif", "--output", "{1}/bubbles.csv"],
    "estimate": [*PAIR, "--output", "{1}/u.tif", "--deviation", "{1}/sd.tif"],
    "evaluate": ["{0}/u.tif", "{0}/true.tif", "--output", "{1}/errors.csv"],
    "stiffness": [*PAIR, *SIZE, "--iterations", "2", "--output", "{1}/E.tif"]
    + ["--displacement", "{1}/u6.tif"],
    "sample": ["--reference", "{0}/a.tif", "--deformed", "{0}/b.tif", "--folder", "{1}/Über 1"]
    + ["--figures", "none", "--error-bars", "0"],
}


def words(step, source, target):
    return [step, *(word.format(source, target) for word in STEPS[step])]


def bytes_of(folder):
    """Content of all files but the one that says when they were made."""
    files = [p for p in folder.rglob("*") if p.is_file() and p.name != "provenance.json"]
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """What all steps write, in a folder with a space and letters of other alphabets."""
    folder = tmp_path_factory.mktemp("sound") / "Prüfung α 日本"
    folder.mkdir()
    for step in STEPS:
        assert main(words(step, folder, folder)) in (0, 3)
    assert len(bytes_of(folder)) > 20
    return folder


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM], ids=["ctrl-c", "sigterm"])
def test_an_ended_step_leaves_nothing_and_gives_the_same_bytes_again(
    sound, tmp_path, monkeypatch, step, ending
):
    target, sent = tmp_path / "out", []
    target.mkdir()
    begin = places._temporary

    def interrupted(*args):
        made = begin(*args)
        sent.append(made.exists())
        os.kill(os.getpid(), ending)
        return made

    monkeypatch.setattr(places, "_temporary", interrupted)
    try:
        status = main(words(step, sound, target))
    except SystemExit as error:
        status = error.code
    assert status == 128 + ending
    assert sent == [True]
    assert bytes_of(target) == {}
    if ending == signal.SIGTERM:
        monkeypatch.undo()
        assert main(words(step, sound, target)) in (0, 3)
        made = bytes_of(target)
        before = bytes_of(sound)
        assert made == {name: before[name] for name in made} != {}


def test_what_kill_9_leaves_is_cleared_away_by_the_next_step(sound, tmp_path):
    code = (
        "import os, sys, eofm.io.places as p, eofm.app.cli as cli; begin = p._temporary\n"
        "def dying(*a): begin(*a); os.kill(os.getpid(), 9)\n"
        "p._temporary = dying; cli.main(sys.argv[1:])"
    )
    command = [sys.executable, "-c", code, *words("evaluate", sound, tmp_path)]
    assert subprocess.run(command).returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".eofm-")
    # Of processes that live, and of other machines, none is touched.
    machine = left.name.split("-")[1]
    others = [f".eofm-{machine}-{os.getpid()}-x.tif", f".eofm-another-{left.name[-1]}-x.tif"]
    for name in others:
        (tmp_path / name).touch()
    assert main(words("evaluate", sound, tmp_path)) == 0
    found = {p.name for p in tmp_path.iterdir()}
    assert found == {"errors.csv", "errors.csv.sha256", *others}


@pytest.fixture
def disk(tmp_path):
    """A small disk of its own."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("wants the right to mount a disk")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


@pytest.mark.parametrize("step", ["phantom", "estimate", "sample"])
def test_a_full_disk_is_named_with_the_file(sound, disk, capfd, step):
    (disk / "ballast").write_bytes(bytes(55_000))
    assert main(words(step, sound, disk)) == 1
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "cannot be written (No space left on device; free some of the disk at" in error
    assert f"{disk}, or write elsewhere" in error
    assert [p.name for p in disk.rglob("*") if p.is_file()] == ["ballast"]


def test_a_file_larger_than_allowed_is_named(sound, tmp_path, capfd):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        assert main(words("estimate", sound, tmp_path)) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    error = capfd.readouterr().err
    assert error == f"eofm estimate: {tmp_path}/u.tif: cannot be written (File too large)\n"
    assert bytes_of(tmp_path) == {}


def test_a_disk_that_cannot_be_written_to_is_named_before_any_work(sound, disk, capfd, monkeypatch):
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    monkeypatch.setattr(io, "read_pair", lambda *_: pytest.fail("it works already"))
    assert main(words("estimate", sound, disk)) == 1
    assert f"nothing can be written to the folder {disk}" in capfd.readouterr().err


def test_an_input_that_is_replaced_meanwhile_is_noticed(sound, tmp_path, capfd, monkeypatch):
    source, target = tmp_path / "in", tmp_path / "out"
    shutil.copytree(sound, source)
    target.mkdir()
    begin = places._temporary

    def replaced(*args):
        shutil.copy(source / "b.tif", tmp_path / "c.tif")
        (tmp_path / "c.tif").replace(source / "b.tif")
        return begin(*args)

    monkeypatch.setattr(places, "_temporary", replaced)
    assert main(words("estimate", source, target)) == 1
    assert "b.tif: changed while it was used; nothing is written" in capfd.readouterr().err
    assert bytes_of(target) == {}


def read(path):
    if path.suffix == ".csv":
        columns = ("e_rel",) if path.name == "errors.csv" else io.BUBBLE_COLUMNS
        return io.read_columns(path, columns).to_numpy()
    return io.formats.read_array(path).values


@pytest.mark.parametrize("name", ["u.tif", "E.tif", "bubbles.csv", "errors.csv"])
def test_a_changed_byte_and_a_cut_are_noticed_wherever_they_are(sound, tmp_path, name):
    data, random = (sound / name).read_bytes(), Random(name)
    path = tmp_path / name
    if path.suffix == ".csv":
        shutil.copy(sound / f"{name}.sha256", tmp_path)
    path.write_bytes(data)
    values, refused = read(path), 0
    bits = [(random.randrange(len(data)), 1 << random.randrange(8)) for _ in range(200)]
    cuts = [(random.randrange(len(data)), 0) for _ in range(50)]
    for at, bit in itertools.chain(bits, cuts):
        path.write_bytes(data[:at] + (bytes([data[at] ^ bit]) + data[at + 1 :] if bit else b""))
        try:
            # Bytes of labels, or padding, may change: the values may not.
            np.testing.assert_array_equal(read(path), values)
        except InputError as error:
            refused += "\n" not in str(error)
    assert refused > 150


@pytest.mark.parametrize(("side", "status"), [(200, 0), (6000, 1)])
def test_a_gigabyte_of_memory(tmp_path, side, status):
    """Small images are estimated in it, and of large ones one line says that they are."""
    I = np.random.default_rng(0).random((side, side), dtype=np.float32)
    for name in ("a.tif", "b.tif"):
        tifffile.imwrite(tmp_path / name, I)
    code = "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))\n"
    code += "from eofm.app.cli import main; sys.exit(main(sys.argv[1:]))"
    pair = [str(tmp_path / name) for name in ("a.tif", "b.tif")]
    command = [sys.executable, "-c", code, "estimate", *pair, "--output", str(tmp_path / "u.tif")]
    done = subprocess.run([*command, "--threads", "2"], capture_output=True, text=True)
    assert done.returncode == status, done.stderr
    assert (tmp_path / "u.tif").exists() == (status == 0)
    if status:
        assert done.stderr.count("\n") == 1
        assert "memory" in done.stderr or "asks for" in done.stderr


def test_names_of_a_machine_have_dashes():
    name = ".eofm-a-node-7-12345-k_x8.tif"
    match = places.TEMPORARY.fullmatch(name)
    assert match is not None
    assert (match["machine"], match["process"]) == ("a-node-7", "12345")
