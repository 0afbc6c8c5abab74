"""What a result comes from, and checksums that tell whether it is still what was written.

Every file that a step writes says which version made it, by which step, with which settings
and from which inputs. It says neither when nor where, so that the same inputs give the same
bytes; :meth:`Origin.run` has that.
"""

import hashlib
import os
import platform
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from eofm.errors import InputError

_current: ContextVar["Origin | None"] = ContextVar("origin", default=None)

LIBRARIES = ("numpy", "scipy", "numba", "pandas", "scikit-image", "scikit-fem", "tifffile")

# Size, times and number of a file: others where it was replaced.
Mark = tuple[int, ...]


@dataclass
class Origin:
    """What the files written inside of :meth:`recorded` come from.

    Attributes
    ----------
    step : str
        What makes them.
    settings : dict
        All of its settings, by section.
    inputs : dict
        Path, SHA-256 and mark of the files read so far.
    """

    step: str
    settings: dict[str, dict[str, Any]]
    inputs: dict[Path, tuple[str, Mark]] = field(default_factory=dict)

    @staticmethod
    def current() -> "Origin | None":
        """Return what files written now come from, if that is recorded."""
        return _current.get()

    @contextmanager
    def recorded(self) -> Iterator["Origin"]:
        """Note all files that are read inside, and say so in all that are written.

        Raises
        ------
        InputError
            At the end, if a file that was read has been replaced meanwhile.
        """
        token = _current.set(self)
        try:
            yield self
            for path, (_, before) in self.inputs.items():
                if not path.exists() or mark(path) != before:
                    raise InputError(f"{path}: changed while it was used; nothing is written")
        finally:
            _current.reset(token)

    def record(self) -> dict[str, Any]:
        """Version, step, settings and the SHA-256 of inputs; files by name, without folders."""
        return {
            "eofm": _version("eofm"),
            "step": self.step,
            "settings": _without_folders(self.settings),
            "inputs": [
                {"file": name, "sha256": digest}
                for name, digest in sorted((p.name, d) for p, (d, _) in self.inputs.items())
            ],
        }

    def run(self) -> dict[str, Any]:
        """When, on what and by which words the step ran."""
        return {
            "when": datetime.now(UTC).isoformat(timespec="seconds"),
            "machine": platform.node(),
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            "libraries": {name: _version(name) for name in LIBRARIES},
            "command": sys.argv,
            "folder": str(Path.cwd()),
            "inputs": {str(path): digest for path, (digest, _) in self.inputs.items()},
        }


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Note a file as an input, as it was before and after it was read.

    Raises
    ------
    InputError
        If it changed meanwhile.
    """
    origin = _current.get()
    if origin is None:
        yield
        return
    place = path.resolve()
    before = mark(place)
    digest = checksum(place)
    yield
    if mark(place) != before or origin.inputs.setdefault(place, (digest, before))[0] != digest:
        raise InputError(f"{path}: changed while it was read; wait until it is complete")


def check_not_read(path: Path) -> None:
    """Refuse to write over a file that the step has read."""
    origin = _current.get()
    if origin is not None and path.resolve() in origin.inputs:
        raise InputError(f"{path}: is read; name another file to write")


def checksum(path: Path) -> str:
    """SHA-256 of a file, as ``sha256sum`` says it, or of the names and files of a folder."""
    if path.is_dir():
        digest = hashlib.sha256()
        for file in _files(path):
            digest.update(f"{checksum(file)}  {file.relative_to(path).as_posix()}\n".encode())
        return digest.hexdigest()
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def mark(path: Path) -> Mark:
    """Size, newest time and number of a file or a folder."""
    at = [file.stat() for file in (_files(path) if path.is_dir() else [path])]
    newest = max((a.st_mtime_ns for a in at), default=0)
    return sum(a.st_size for a in at), newest, at[0].st_ino if at else 0


def _files(folder: Path) -> list[Path]:
    """The files in a folder, by name; what is no regular file is none of it."""
    return sorted(file for file in folder.rglob("*") if file.is_file())


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # a checkout that is not installed
        return "unknown"


def _without_folders(value: Any) -> Any:
    """The same settings wherever their files are."""
    if isinstance(value, dict):
        return {key: _without_folders(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_folders(item) for item in value]
    return re.sub(r"\S*/", "", value) if isinstance(value, str) else value
