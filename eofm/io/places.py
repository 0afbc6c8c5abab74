"""Where files are written: each complete or not at all, and those of a step as one.

A file is written beside its place and then moved there, so that a failure, an interruption or
a full disk leaves nothing half-written. What kill -9 leaves, the next step that writes there
clears away.
"""

import errno
import os
import platform
import re
import signal
import stat
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from eofm.errors import InputError

# What to do, in this order, once all files of a step are complete: move, or remove (None).
Move = tuple[Path | None, Path]
_moves: ContextVar[list[Move] | None] = ContextVar("moves", default=None)

# Endings by format, and formats that a name with another ending would belie.
ENDINGS = {"TIFF": (".tif", ".tiff"), "CSV": (".csv", ".txt"), "JSON": (".json",), "VTI": (".vti",)}

# Temporary files say whose they are: machine and process.
TEMPORARY = re.compile(r"\.eofm-(?P<machine>.*)-(?P<process>\d+)-[^-]*")
# Those of other machines are left alone for so long, s.
DAY = 86400
# Signals that end a process.
ENDING = ("SIGINT", "SIGTERM", "SIGHUP")


def check_place(path: str | Path, format: str | None = None) -> Path:
    """The path of a file to write; one that could not be, or should not be, replaced is refused.

    Raises
    ------
    InputError
        If it is a folder, a device or write-protected, its folder does not exist or cannot be
        written to, or its name ends like that of another format.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file in it")
    folder = path.resolve().parent
    if not folder.is_dir():
        raise InputError(f"{path}: the folder {folder} does not exist; create it first")
    endings = ENDINGS.get(format or "", ())
    if endings and path.suffix and path.suffix.lower() not in endings:
        raise InputError(
            f"{path}: is to hold {format} but its name ends in {path.suffix}; use {endings[0]}"
        )
    if path.exists():
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            raise InputError(f"{path}: is no regular file; name another file to write")
        # Root may write where no one may; the owner has said that no one should.
        if not mode & 0o222 or not os.access(path, os.W_OK):
            raise InputError(f"{path}: is write-protected; name another file to write")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{path}: nothing can be written to the folder {folder}")
    return path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary file that takes the place of ``path`` once it is complete.

    A symbolic link stays, and the file that it leads to is replaced.
    """
    path = check_place(path)
    place = path.resolve()
    clear(place.parent)
    temporary, waits = None, False
    try:
        with _uninterrupted():  # so that what was made is known
            temporary = _temporary(place)
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        waits = _later((temporary, place))
        if not waits:
            temporary.replace(place)
    except OSError as error:
        if temporary is not None and error.errno is None:
            error = _asked_again(temporary) or error
        raise _named(error, path) from None
    finally:
        if temporary is not None and not waits:
            temporary.unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Remove temporary files of processes that have ended."""
    with os.scandir(folder) as entries:
        found = [(e, m) for e in entries if (m := TEMPORARY.fullmatch(e.name))]
    for entry, match in found:
        # Another process may clear, or finish, at the same time.
        with suppress(FileNotFoundError):
            if match["machine"] == platform.node():
                stale = not _is_alive(int(match["process"]))
            else:
                stale = time.time() - entry.stat().st_mtime > DAY
            if stale:
                os.unlink(entry.path)


def _is_alive(process: int) -> bool:
    if os.name != "posix":  # where asking so would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        return True
    return True


def _temporary(place: Path) -> Path:
    prefix = f".eofm-{platform.node()}-{os.getpid()}-"
    handle, name = tempfile.mkstemp(dir=place.parent, prefix=prefix, suffix=place.suffix)
    os.close(handle)
    return Path(name)


def remove(path: Path) -> None:
    """Remove a file if it is there, inside of `together` at its end."""
    if not _later((None, path)):
        path.unlink(missing_ok=True)


@contextmanager
def together() -> Iterator[None]:
    """Files that are written inside take their places as one at the end, or none does.

    Signals wait while they do, and the last file is removed first: should even the machine
    stop then, all others belong to it wherever it stands.
    """
    if _moves.get() is not None:  # those around it see to it
        yield
        return
    moves: list[Move] = []
    token = _moves.set(moves)
    try:
        yield
        with _uninterrupted():
            if len(moves) > 1:
                moves[-1][1].unlink(missing_ok=True)
            for temporary, place in moves:
                if temporary is None:
                    place.unlink(missing_ok=True)
                else:
                    temporary.replace(place)
    finally:
        _moves.reset(token)
        for temporary, _ in moves:
            if temporary is not None:
                temporary.unlink(missing_ok=True)


def _later(move: Move) -> bool:
    """Whether a file has to wait for others; then it does."""
    moves = _moves.get()
    if moves is not None:
        moves.append(move)
    return moves is not None


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let signals that end the process wait.

    Handlers of our own note them: a mask would hold for this thread, and the system would hand
    the signal to another, such as those of compiled loops.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    before = {}
    try:
        for name in ENDING:
            number = getattr(signal, name, None)  # not all of them are on Windows
            if number is not None:
                before[number] = signal.signal(number, lambda number, _: caught.append(number))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
        for number in caught[:1]:
            signal.raise_signal(number)


def _asked_again(temporary: Path) -> OSError | None:
    """Why no more can be written, which NumPy does not say of its arrays."""
    try:
        with temporary.open("ab") as file:
            file.write(bytes(1 << 16))
    except OSError as error:
        return error
    return None


def _named(error: OSError, path: Path) -> OSError:
    """The same error, which names the file that was to be written, and a disk that is full."""
    why = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        disk = path.resolve().parent
        while not os.path.ismount(disk):
            disk = disk.parent
        why += f"; free some of the disk at {disk}, or write elsewhere"
    return OSError(f"{path}: cannot be written ({why})")
