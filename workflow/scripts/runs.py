"""One run in a folder at a time, and none of the jobs of a run that was killed."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from typing import IO

import psutil

from eofm.errors import InputError

# Jobs inherit this variable: the folder of their run.
MARK = "EOFM_RUN"
# Seconds that jobs have to end in order.
PATIENCE = 10


def only_run(folder: Path) -> IO[str] | None:
    """Lock a folder for as long as this process lives, or what is returned is kept.

    The system ends the lock with its process, so that none is left by kill -9. Jobs that such a
    run has left on this machine are ended, for they would write beside those of this run.

    Raises
    ------
    InputError
        If another process holds it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = (folder / "eofm.lock").open("a+")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        other = file.read().strip()
        file.close()
        raise InputError(
            f"another run (process {other}) is at work in {Path.cwd()}; wait for it,"
            " or use another folder (--directory)"
        ) from None
    except OSError:  # a file system without locks
        file.close()
        return None
    file.truncate(0)
    file.write(f"{os.getpid()}\n")
    file.flush()
    end_jobs(folder)
    os.environ[MARK] = str(folder.resolve())
    return file


def end_jobs(folder: Path) -> None:
    """End the processes of an earlier run in a folder."""
    mark, mine = str(folder.resolve()), os.getpid()
    left = [
        process
        for process in psutil.process_iter(["environ"])
        if process.pid != mine and (process.info["environ"] or {}).get(MARK) == mark
    ]
    for end in (psutil.Process.terminate, psutil.Process.kill):
        for process in left:
            with suppress(psutil.Error):  # it may have ended by itself
                end(process)
        _, left = psutil.wait_procs(left, timeout=PATIENCE)
