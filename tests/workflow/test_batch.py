"""Many samples: rows in parts, rows that fail alone, and what is not computed again."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tifffile

import eofm
from eofm import io
from eofm.errors import InputError

sys.path.insert(0, str(Path(__file__).parents[2] / "workflow/scripts"))
from parts import Size, memory, minutes, parts, seconds, size
from runs import only_run
from sample_rows import run_rows
from samples_left import write_what_is_left


def test_parts_hold_every_row_once_and_few_start():
    samples = {f"s{n}": {"roi": "0 0 180 100"} for n in range(500)}
    found = parts(samples)
    assert [name for part in found for name in part] == list(samples)
    assert len(found) <= 50
    assert parts(dict(list(samples.items())[:3])) == [["s0"], ["s1"], ["s2"]]


def test_sizes_are_those_of_the_files_and_of_regions(tmp_path):
    for name, values in {"a.tif": np.zeros((9, 12)), "v.tif": np.zeros((8, 9, 10))}.items():
        io.write_image(tmp_path / name, values)
    tifffile.imwrite(tmp_path / "bytes.tif", np.zeros((9, 12), np.uint8))
    (tmp_path / "other.png").write_bytes(bytes(700))

    def of(name, **more):
        return size({"reference": str(tmp_path / name), **more})

    assert of("a.tif") == of("bytes.tif") == (108, 2)
    assert of("a.tif", roi="0 0 8 8") == (64, 2)
    assert of("v.tif") == of("v.tif", roi="0 0 8 8") == (720, 3)
    assert of("v.tif", roi="0 0 0 8 8 8") == (512, 3)
    assert of("other.png") == (700, 2)
    assert size({"reference": "nowhere.tif"}) == (100_000, 2)
    # What is asked for grows with the rows in time, and with the largest in memory.
    small, large = Size(10_000, 2), Size(4_000_000, 2)
    assert memory([small, large, small]) == memory([large]) > 4 * memory([small])
    assert seconds([small, large]) > seconds([large])
    assert minutes([large] * 9) > minutes([large])


@pytest.mark.slow
def test_an_edit_reruns_its_row_and_a_broken_row_costs_itself(tmp_path):
    I1, I2, _ = eofm.make_phantom(np.zeros((2, 40, 60)), eofm.Phantom(count=60, seed=2))
    io.write_image(tmp_path / "a.tif", I1)
    io.write_image(tmp_path / "b.tif", I2)
    files = [str(tmp_path / "a.tif"), str(tmp_path / "b.tif")]
    words = ["--figures=none", "--error-bars=0", f"--reference={files[0]}"]
    words += [f"--deformed={files[1]}"]
    rows = {
        name: {"words": [*words, *more], "files": files, "log": str(tmp_path / f"{name}.log")}
        | {"seconds": 600}
        for name, more in {"one": [], "bad": ["--top=glued"], "two": []}.items()
    }
    folder = tmp_path / "results"

    def run():
        run_rows(rows, folder, [], 1)
        states = {name: json.loads((folder / name / "state.json").read_text()) for name in rows}
        times = {n: (folder / n / "summary.json").stat().st_mtime_ns for n in ("one", "two")}
        return states, times

    states, before = run()
    assert {name: s["state"] for name, s in states.items()} == {
        "one": "done",
        "bad": "unusable",
        "two": "done",
    }
    assert "glued" in states["bad"]["reason"]
    rows["two"]["words"].append("--alpha=0.1")
    _, after = run()
    assert after["one"] == before["one"]
    assert after["two"] > before["two"]


def test_a_folder_has_one_run_and_kill_9_leaves_no_lock(tmp_path):
    code = "import sys, pathlib, time, runs; k = runs.only_run(pathlib.Path(sys.argv[1]));"
    code += "print('held', flush=True); time.sleep(60)"
    scripts = str(Path(__file__).parents[2] / "workflow/scripts")
    env = os.environ | {"PYTHONPATH": f"{scripts}:{Path(__file__).parents[2]}"}
    command = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(command, env=env, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(InputError, match=f"process {other.pid}"):
            only_run(tmp_path)
        other.kill()
    held = only_run(tmp_path)
    assert held is not None
    held.close()


def test_rows_of_a_killed_job_stand_in_the_table_with_what_the_cluster_says(tmp_path, capsys):
    kept = {"sample": "a", "state": "done", "reason": "", "seconds": 1.5, "key": "x"}
    (tmp_path / "a").mkdir()
    (tmp_path / "a/.state.json").write_text(json.dumps(kept))
    log = tmp_path / "run.log"
    log.write_text(
        "Error in rule samples_1:\n"
        "    message: SLURM-job '7' failed, SLURM status is: 'TIMEOUT'. Detailed reason: none.\n"
        "    jobid: 4\n"
        "Error in rule samples_2:\n    jobid: 5\n"
    )
    rows = {"a": "samples_0", "b": "samples_1", "c": "samples_2"}
    write_what_is_left(rows, tmp_path, [str(log)])
    table = pd.read_csv(tmp_path / "summary.csv").set_index("sample")
    assert table.state.to_dict() == {"a": "done", "b": "crashed", "c": "crashed"}
    ended = "its job ended before it was done"
    assert table.reason["b"].startswith(
        f"{ended} (SLURM-job '7' failed, SLURM status is: 'TIMEOUT')"
    )
    assert table.reason["c"] == f"{ended}; the next run tries it again"
    assert capsys.readouterr().err.splitlines()[-1] == "2 of 3 samples have no results"
