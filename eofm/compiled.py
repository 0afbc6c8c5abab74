"""Loops over rows, compiled by numba: once on a machine, and shared among threads.

A kernel is a function ``f(first, last, *arrays)`` that does the rows ``first`` to ``last - 1`` of
something, each in one order whoever does it: so results do not depend on the number of threads.
It is compiled without threads in it, which takes a third of the time of numba's own parallel
loops, and :func:`share` runs it in as many threads as there are.
"""

import logging
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from itertools import pairwise
from pathlib import Path
from threading import RLock
from typing import Any

from numba import config, njit
from numba.core import event

try:
    import fcntl
except ImportError:  # no such locks on Windows: several processes may compile the same
    fcntl = None  # type: ignore[assignment]

# Numbers in the arrays below which handing rows to threads costs more than it saves.
SERIAL = 2**16

_log = logging.getLogger(__name__)
_lock = RLock()
_held: set[str] = set()
_threads: int = config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]


def use_threads(count: int) -> int:
    """Let kernels take ``count`` threads from now on; return how many they took before.

    At first these are as many as the variable NUMBA_NUM_THREADS says, or the processors.
    """
    global _threads
    before, _threads = _threads, count
    return before


def share(kernel: Callable[..., None], rows: int, work: int, *arrays: Any) -> None:
    """Run a kernel on all rows, by several threads where the work (numbers) is worth it."""
    parts = min(_threads, rows) if work >= SERIAL else 1
    if parts == 1:
        kernel(0, rows, *arrays)
        return
    cuts = [rows * k // parts for k in range(parts + 1)]
    submit = _pool(_threads - 1).submit
    others = [submit(kernel, first, last, *arrays) for first, last in pairwise(cuts[1:])]
    kernel(0, cuts[1], *arrays)
    for other in others:
        other.result()


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, "eofm")


if hasattr(os, "register_at_fork"):  # a child has none of its parent's threads
    os.register_at_fork(after_in_child=_pool.cache_clear)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a kernel: compiled when it is called first, by one process for all.

    Its machine code is kept next to the module or in NUMBA_CACHE_DIR. Functions that kernels
    call need numba's own decorator only, in the same file: numba sees no edits of others.
    """
    # A check for division by zero would keep loops from being vectorised.
    kernel = njit(cache=True, nogil=True, error_model="numpy")(function)
    find = kernel.compile

    def find_or_compile(signature: Any) -> Any:
        with _alone(kernel.stats.cache_path), event.install_listener("numba:compile", _Say()):
            try:
                return find(signature)
            except (AttributeError, ImportError):  # machine code for a class of another version
                folder = Path(kernel.stats.cache_path or ".")
                for index in folder.glob(f"*.{function.__qualname__}-*.nbi"):
                    index.unlink()
                return find(signature)

    kernel.compile = find_or_compile  # type: ignore[assignment, method-assign]
    return kernel


@contextmanager
def _alone(folder: str | None) -> Iterator[None]:
    """Keep other threads, and other processes with the same folder, from compiling."""
    with _lock, ExitStack() as held:
        if folder is not None and fcntl is not None and folder not in _held:
            # A folder that cannot be written gets no new code to wait for, and some network
            # drives know no locks.
            with suppress(OSError):
                Path(folder).mkdir(parents=True, exist_ok=True)
                file = held.enter_context(open(Path(folder) / "compiling.lock", "w"))
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    fcntl.flock(file, fcntl.LOCK_EX)
                _held.add(folder)
                held.callback(_held.remove, folder)
        yield


class _Say(event.Listener):
    """Says once what takes so long."""

    def on_start(self, _: event.Event) -> None:
        _say()

    def on_end(self, _: event.Event) -> None:
        pass


@cache
def _say() -> None:
    _log.warning("compiling a part of eofm; this installation keeps it (up to a minute)")
