"""What must not be lost: inputs, results of an earlier run, and what a result comes from."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
import tifffile

import eofm
from eofm import io
from eofm.app.cli import main

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Two images and a table of an edge's motion."""
    folder = tmp_path_factory.mktemp("scans")
    u = np.zeros((2, 40, 60))
    u[1] = -0.02 * np.arange(40)[:, None]
    I1, I2, _ = eofm.make_phantom(u, eofm.Phantom(count=60, seed=2))
    io.write_image(folder / "a.tif", I1)
    io.write_image(folder / "b.tif", I2)
    return folder


def words(scans, folder, *more):
    pair = ["--reference", scans / "a.tif", "--deformed", scans / "b.tif"]
    return [str(w) for w in ["sample", *pair, "--folder", folder, "--error-bars", 0, *more]]


@pytest.fixture(scope="module")
def results(scans):
    assert main(words(scans, scans / "results")) == 0
    return scans / "results"


def state(folder):
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.iterdir()}


def test_a_summary_says_what_it_comes_from(scans, results):
    said = json.loads((results / "summary.json").read_text())["provenance"]
    digests = {p.name: io.checksum(p) for p in (scans / "a.tif", scans / "b.tif")}
    assert {i["file"]: i["sha256"] for i in said["inputs"]} == digests
    assert said["settings"]["pair"]["error_bars"] == 0
    assert set(said["settings"]) == {"pair", "tracking", "estimation", "identification"}
    run = json.loads((results / "provenance.json").read_text())["run"]
    assert {"when", "machine", "command", "libraries"} <= set(run)
    with tifffile.TiffFile(results / "strain.tif") as file:
        assert json.loads(file.imagej_metadata["Info"]) == said


@pytest.mark.slow
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_sample_leaves_the_results_as_they_were(scans, results, tmp_path, ending):
    folder = tmp_path / "results"
    shutil.copytree(results, folder)
    before = state(folder)
    command = words(scans, folder, "--tolerance", 4)
    # Interrupted when half of its files are written.
    code = (
        "import sys, time, eofm.app.cli as cli, eofm.analysis.figures as f; save = f.save\n"
        "def slow(*a): save(*a); print('half', flush=True); time.sleep(20)\n"
        "f.save = slow; sys.exit(cli.main(sys.argv[1:]))"
    )
    step = subprocess.Popen([sys.executable, "-c", code, *command], stdout=subprocess.PIPE)
    assert step.stdout.readline() == b"half\n"
    step.send_signal(ending)
    assert step.wait(10) == 128 + ending
    step.stdout.close()
    assert state(folder) == before


@pytest.mark.slow
def test_killed_while_files_move_there_is_no_summary(scans, results, tmp_path):
    folder = tmp_path / "results"
    shutil.copytree(results, folder)
    code = (
        "import os, sys, pathlib, eofm.app.cli as cli; move = pathlib.Path.replace; n = []\n"
        "def dying(self, to):\n"
        "    n.append(1)\n"
        "    return os.kill(os.getpid(), 9) if len(n) > 5 else move(self, to)\n"
        "pathlib.Path.replace = dying; cli.main(sys.argv[1:])"
    )
    command = [sys.executable, "-c", code, *words(scans, folder)]
    assert subprocess.run(command).returncode == -signal.SIGKILL
    assert not (folder / "summary.json").exists()
    assert main(words(scans, folder)) == 0
    assert (folder / "summary.json").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--background", "{}/displacement.tif"], "displacement.tif: is read, and results would"),
        (["--mask", "{}/strain.tif#0"], "strain.tif#0: is read"),
        (["--top", "moved {}/bubbles.csv"], "bubbles.csv: is read"),
        (["--roi", "0 0 40 40 --folder=elsewhere"], "pair: roi"),
        (["--roi", "0 0 40 40", "--strain-window", "1e300"], "strain_window"),
        (["--mask", "nan,0 10,0 10,10"], "mask: the corners"),
        (["--mask", "1e300,0 10,0 10,10"], "mask: the corners"),
        (["--mask", "500,500 600,500 600,600"], "mask: no pixel"),
        (["--extent", "0 0 60 100000000", "--background", "elastic"], "extent: 60 x 100000000"),
        (["--limits", "0", "1e-320"], "limits"),
        (["--local-window", "1e300"], "local_window"),
        (["--sigma", "1e300"], "sigma"),
        (["--scales", "1" + "0" * 30], "scales"),
        (["--alpha", "9" * 5000], "alpha"),
        (["--alpha", "[" * 5000], "alpha"),
        (["--reference", "a\0b.tif"], "a\0b.tif: no such file"),
        (["--max-size", "0.000001"], "asks for"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(scans, results, capsys, more, message):
    before = state(results)
    more = [word.format(results) for word in more]
    assert main(words(scans, results, *more)) == 1
    error = capsys.readouterr().err
    assert message.replace("\0", "\\x00") in error
    assert error.count("\n") == 1
    assert len(error) < 600
    assert state(results) == before


def test_several_values_in_one_word_are_split(scans, tmp_path):
    assert main(words(scans, tmp_path / "r", "--roi", "5 0 40 36", "--figures", "none")) == 0
    assert tifffile.imread(tmp_path / "r" / "displacement.tif").shape == (2, 36, 40)


def test_an_output_is_no_input_and_no_device(scans, capsys):
    pair = [str(scans / "a.tif"), str(scans / "b.tif")]
    before = state(scans) if not (scans / "results").exists() else None
    (scans / "x").mkdir(exist_ok=True)
    u, same = str(scans / "u.tif"), str(scans / "x" / ".." / "u.tif")
    for more, message in [
        (["--output", pair[0]], "is read"),
        (["--output", str(scans / "x" / ".." / "a.tif")], "is read"),
        (["--output", u, "--deviation", same], "two results"),
        (["--output", "/dev/null"], "no regular file"),
        (["--output", str(scans / "u.npy")], "is to hold TIFF"),
        (["--output", u, "--deviation", str(scans / "sd.csv")], "is to hold TIFF"),
    ]:
        assert main(["estimate", *pair, *more]) == 1
        assert message in capsys.readouterr().err
    assert not (scans / "u.tif").exists()
    assert before is None or set(state(scans)) == set(before)


def test_a_damaged_intermediate_ends_the_next_step(scans, tmp_path, capsys):
    out = tmp_path / "u.tif"
    io.write_field(out, np.ones((2, 40, 60)))
    data = bytearray(out.read_bytes())
    with tifffile.TiffFile(out) as file:
        data[file.pages[0].dataoffsets[0] + 99] ^= 64
    out.write_bytes(data)
    assert main(["evaluate", str(out), str(out), "--output", str(tmp_path / "e.csv")]) == 1
    assert "is not what was written" in capsys.readouterr().err
    assert not (tmp_path / "e.csv").exists()


def test_nothing_is_left_in_a_folder_by_what_failed(scans, tmp_path):
    assert main(words(scans, tmp_path / "r", "--top", "glued")) == 1
    assert not (tmp_path / "r").exists()
    assert os.listdir(tmp_path) == []
