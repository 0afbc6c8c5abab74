"""The Slurm profile on a real node of Slurm on this machine."""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path
from subprocess import PIPE

import numpy as np
import pandas as pd
import psutil
import pytest

import eofm
from eofm import io
from eofm.app.cli import main

NEEDED = os.environ.get("EOFM_NEEDS_SLURM") == "1"
TOOLS = ("slurmctld", "slurmd", "munged", "sbatch")
PATH = f"{os.environ['PATH']}:/usr/sbin"
MISSING = [tool for tool in TOOLS if shutil.which(tool, path=PATH) is None]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not NEEDED and (bool(MISSING) or os.geteuid() != 0),
        reason="wants Slurm, munge and root",
    ),
]

CONFIG = """\
ClusterName=eofm
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
SlurmctldPort=16827
SlurmdPort=16828
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SwitchType=switch/none
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
ReturnToService=2
MinJobAge=3600
KillWait=1
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory={memory} State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    """The environment of a Slurm of one node without accounting."""
    folder = tmp_path_factory.mktemp("slurm")
    folder.chmod(0o755)
    for name in ("state", "spool", "munge"):
        (folder / name).mkdir()
    (folder / "munge").chmod(0o700)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") * 9 // 10 // 2**20
    values = {"host": socket.gethostname().partition(".")[0], "cpus": os.cpu_count()}
    conf = folder / "slurm.conf"
    conf.write_text(CONFIG.format(folder=folder, memory=memory, **values))
    default = Path("/etc/slurm/slurm.conf")
    if default.exists() and not default.is_symlink():
        pytest.skip("this machine has a Slurm of its own")
    # The executor's inner srun finds only this place.
    default.parent.mkdir(exist_ok=True)
    default.unlink(missing_ok=True)
    default.symlink_to(conf)
    key = folder / "munge/munge.key"
    key.write_bytes(os.urandom(1024))
    key.chmod(0o600)
    env = os.environ | {"SLURM_CONF": str(conf), "PATH": PATH}
    places = {"key-file": key, "socket": folder / "munge.socket"}
    places |= {k: folder / f"munge/{k}" for k in ("pid-file", "log-file", "seed-file")}
    words = [f"--{name}={place}" for name, place in places.items()]
    subprocess.run(["munged", "--force", *words], env=env, check=True)
    subprocess.run(["slurmctld", "-c", "-f", conf], env=env, check=True)
    subprocess.run(["slurmd", "-f", conf, "-N", values["host"]], env=env, check=True)
    for _ in range(60):
        said = subprocess.run(["sinfo", "-h", "-o", "%T"], env=env, capture_output=True, text=True)
        if "idle" in said.stdout:
            break
        time.sleep(0.5)
    yield env
    subprocess.run(["scancel", "--me", "--full", "--signal=KILL"], env=env, check=True)
    for file in (folder / "slurmd.pid", folder / "slurmctld.pid", folder / "munge/pid-file"):
        if file.exists():
            os.kill(int(file.read_text()), 15)
    default.unlink(missing_ok=True)


ROWS = ("one", "two", "three")


class Run:
    """The target `samples` on Slurm, a job for each of three rows."""

    def __init__(self, folder, root, slurm):
        self.folder, self.root, self.env = folder, root, slurm | {"PYTHONPATH": str(root)}
        shutil.copytree(root / "config", folder / "config")
        u = np.zeros((2, 40, 60))
        u[1] = -0.02 * np.arange(40)[:, None]
        for name, I in zip("ab", eofm.make_phantom(u, eofm.Phantom(count=60)), strict=False):
            io.write_image(folder / f"{name}.tif", I)
        lines = ["sample\treference\tdeformed\tfigures\terror_bars"]
        lines += [f"{row}\ta.tif\tb.tif\tnone\t0" for row in ROWS]
        (folder / "config/samples.tsv").write_text("\n".join(lines) + "\n")

    def start(self):
        command = [sys.executable, "-m", "snakemake", "--snakefile", self.root / "Snakefile"]
        command += ["--profile", self.root / "profiles/slurm", "--directory", self.folder]
        command += ["samples", "--slurm-init-seconds-before-status-checks", "1"]
        return subprocess.Popen(
            command,
            cwd=self.folder,
            env=self.env,
            stdout=subprocess.DEVNULL,
            stderr=PIPE,
            text=True,
        )

    def at_work(self, running):
        """Jobs of two rows by their names, whose processes wait from then on."""
        found = {}
        while len(found) < 2:
            assert running.poll() is None, running.stderr.read()
            time.sleep(0.2)
            for process in psutil.process_iter(["cmdline", "environ"]):
                job = (process.info["environ"] or {}).get("SLURM_JOB_ID")
                if job and "spawn_main" in " ".join(process.info["cmdline"] or []):
                    words = " ".join(w for p in process.parents() for w in p.cmdline())
                    found |= {row: job for n, row in enumerate(ROWS) if f"samples_{n}" in words}
                    process.suspend()
        return found

    def results(self):
        """Displacements by row."""
        return {
            p.parent.name: p.read_bytes() for p in self.folder.glob("results/*/*/displacement.tif")
        }


def test_jobs_past_their_time_and_killed_ones_cost_their_rows(slurm, tmp_path, pytestconfig):
    run = Run(tmp_path, pytestconfig.rootpath, slurm)
    running = run.start()
    (late, in_time), (killed, dying) = run.at_work(running).items()
    # One never ends, and its time is up in a second instead of minutes; one dies on its node.
    limit = ["scontrol", "update", f"JobId={in_time}", "EndTime=now+1"]
    subprocess.run(limit, env=slurm, check=True)
    for process in psutil.process_iter(["environ"]):
        if (process.info["environ"] or {}).get("SLURM_JOB_ID") == dying:
            process.kill()
    said = running.communicate(timeout=900)[1]
    assert running.returncode == 1
    assert "2 of 3 samples have no results" in said
    table = pd.read_csv(tmp_path / "results/samples/summary.csv").set_index("sample")
    (sound,) = set(ROWS) - {late, killed}
    assert table.state.to_dict() == {late: "crashed", killed: "crashed", sound: "done"}
    assert "TIMEOUT" in table.reason[late]
    assert "FAILED" in table.reason[killed]
    assert set(run.results()) == {sound}

    # The next run makes what is missing: the bytes are those of a step on this machine.
    again = run.start()
    said = again.communicate(timeout=900)[1]
    assert again.returncode == 0, said
    words = ["sample", "--reference", "a.tif", "--deformed", "b.tif", "--folder", "here"]
    with contextlib.chdir(tmp_path):
        assert main([*words, "--figures", "none", "--error-bars", "0"]) == 0
    here = (tmp_path / "here/displacement.tif").read_bytes()
    assert run.results() == dict.fromkeys(ROWS, here)
