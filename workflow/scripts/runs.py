"""One run in a folder at a time."""

import fcntl
import os
from pathlib import Path
from typing import IO

from eofm.errors import InputError


def only_run(folder: Path) -> IO[str] | None:
    """Lock a folder for as long as this process lives, or what is returned is kept.

    The system ends the lock with its process, so that none is left by kill -9.

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
    return file
