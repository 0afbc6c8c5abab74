"""The Slurm profile on a real node of Slurm on this machine."""

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

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
    for file in (folder / "slurmd.pid", folder / "slurmctld.pid", folder / "munge/pid-file"):
        if file.exists():
            os.kill(int(file.read_text()), 15)
    default.unlink(missing_ok=True)


def test_a_run_on_slurm_gives_the_bytes_of_a_local_one(slurm, tmp_path, pytestconfig):
    root = pytestconfig.rootpath
    target, written = "results/phantom/background.tif", []
    for profile in ("default", "slurm"):
        folder = tmp_path / profile
        shutil.copytree(root / "config", folder / "config")
        command = [sys.executable, "-m", "snakemake", "--snakefile", root / "Snakefile"]
        command += ["--profile", root / "profiles" / profile, "--directory", folder]
        command += ["--configfile", "config/config.yaml", root / "tests/small.yaml", "--", target]
        env = slurm | {"PYTHONPATH": str(root)}
        done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        written.append((folder / target).read_bytes())
    assert written[0] == written[1]
