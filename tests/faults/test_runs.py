"""Runs of the workflow that are ended, killed, started twice; and folders of all names."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

import eofm
from eofm import io

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
ROWS = 2


class Run:
    """The target `samples` in a folder, with the checkout elsewhere."""

    def __init__(self, checkout, folder):
        self.checkout, self.folder = checkout, folder
        shutil.copytree(checkout / "config", folder / "config")
        u = np.zeros((2, 60, 80))
        u[1] = -0.02 * np.arange(60)[:, None]
        I1, I2, _ = eofm.make_phantom(u, eofm.Phantom(count=90, seed=2))
        (folder / "Bilder größe 1").mkdir()
        io.write_image(folder / "Bilder größe 1/vor ∂.tif", I1)
        io.write_image(folder / "Bilder größe 1/nach.tif", I2)
        lines = ["sample\treference\tdeformed\tfigures\troi"]
        pair = "Bilder größe 1/vor ∂.tif\tBilder größe 1/nach.tif\tnone"
        lines += [f"row{k}\t{pair}\t0 0 80 {60 - k}" for k in range(ROWS)]
        (folder / "config/samples.tsv").write_text("\n".join(lines) + "\n")

    def command(self, *words):
        place = ["--snakefile", self.checkout / "Snakefile", "--directory", self.folder]
        profile = ["--profile", self.checkout / "profiles/default", "--cores", "1"]
        return [sys.executable, "-m", "snakemake", *place, *profile, *(words or ["samples"])]

    def start(self):
        env = os.environ | {"PYTHONPATH": str(ROOT)}
        return subprocess.Popen(
            list(map(str, self.command())),
            cwd=self.folder,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            process_group=0,
        )

    def end(self, process):
        """Wait for the end, and return its status and all that it said."""
        said = process.communicate(timeout=1800)[1]
        return process.returncode, said

    def states(self):
        found = self.folder.glob("results/samples/*/state.json")
        return {p.parent.name: json.loads(p.read_text())["state"] for p in found}

    def wait_for_a_row(self, process):
        """Wait until a row is at work; return its process."""
        for _ in range(12000):
            if found := self.jobs("spawn_main"):
                return found[0]
            assert process.poll() is None, self.end(process)
            time.sleep(0.05)
        raise TimeoutError

    def jobs(self, word):
        """Processes of this folder's jobs whose command line holds a word."""
        mark, found = str(self.folder / ".snakemake"), []
        for process in psutil.process_iter(["environ", "cmdline"]):
            ours = (process.info["environ"] or {}).get("EOFM_RUN") == mark
            if ours and word in " ".join(process.info["cmdline"] or []):
                found.append(process)
        return found

    def results(self):
        files = self.folder.glob("results/samples/*/*")
        kept = [p for p in files if p.suffix in (".tif", ".csv") or p.name == "summary.json"]
        return {f"{p.parent.name}/{p.name}": p.read_bytes() for p in kept}


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A checkout that cannot be written to, even by root where it may mount."""
    folder = tmp_path_factory.mktemp("checkout")
    shutil.copy(ROOT / "Snakefile", folder)
    for part in ("config", "workflow", "profiles"):
        shutil.copytree(ROOT / part, folder / part)
    mounts = [["mount", "--bind", folder, folder], ["mount", "-o", "remount,bind,ro", folder]]
    able = shutil.which("mount") and all(
        subprocess.run(m, capture_output=True).returncode == 0 for m in mounts
    )
    yield folder
    if able:
        subprocess.run(["umount", "--lazy", folder], check=True)


@pytest.fixture(scope="module")
def undisturbed(checkout, tmp_path_factory):
    run = Run(checkout, tmp_path_factory.mktemp("plain"))
    status, said = run.end(run.start())
    assert status == 0, said
    assert len(run.results()) == ROWS * 8
    return run.results()


def test_a_run_goes_on_after_every_end_with_the_same_bytes(checkout, undisturbed, tmp_path):
    folder = tmp_path / "Prüf ordner α 日本"
    folder.mkdir()
    run = Run(checkout, folder)

    # Ctrl-C ends the jobs, SIGTERM lets them finish; both while the first row is at work.
    for ending in (signal.SIGINT, signal.SIGTERM):
        process = run.start()
        run.wait_for_a_row(process)
        if ending == signal.SIGINT:
            os.killpg(process.pid, ending)
        else:
            process.send_signal(ending)
        status, said = run.end(process)
        assert status == 1 or status == -ending, said
        assert "Traceback" not in said

    # Kill -9 of the run: its jobs are ended by the next, and it takes one command.
    (folder / "config/samples.tsv").touch()
    for state in folder.glob("results/samples/*/*state.json"):
        state.unlink()
    process = run.start()
    run.wait_for_a_row(process)
    process.kill()
    # Its jobs hold its standard error: to read that to the end would be to wait for them.
    process.wait()
    process.stderr.close()
    orphans = run.jobs("")
    assert orphans

    # A second run in the folder ends in one line; kill -9 of a job costs its row.
    process = run.start()
    psutil.wait_procs(orphans, timeout=60)
    run.wait_for_a_row(process)
    second, line = run.end(run.start())
    assert second == 1
    assert f"another run (process {process.pid}) is at work" in line
    status, said = run.end(process)
    assert status == 0, said
    assert run.results() == undisturbed
    assert not list(folder.rglob(".eofm-*"))


def test_a_killed_job_costs_its_row_and_the_next_run_tries_it_again(
    checkout, undisturbed, tmp_path
):
    run = Run(checkout, tmp_path)
    process = run.start()
    run.wait_for_a_row(process).kill()
    status, said = run.end(process)
    assert status == 1
    assert "crashed: its process ended, perhaps for want of memory; the next run" in said
    table = (tmp_path / "results/samples/summary.csv").read_text()
    assert table.count(",done,") == ROWS - 1
    status, said = run.end(run.start())
    assert status == 0, said
    assert run.results() == undisturbed
