"""How many threads libraries take."""

import os
import sys
from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController, threadpool_limits

from eofm.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")


def use_threads(count: int | None) -> None:
    """Give compiled loops some threads, as many as there are cores at most, and BLAS one.

    BLAS would take as many as there are cores, and its sums depend on their number.

    Raises
    ------
    InputError
        If the count is no positive number.
    """
    if count is not None and count < 1:
        raise InputError(f"threads: wants a positive number (got {count})")
    threadpool_limits(1, user_api="blas")
    if count is None:
        return
    # More only wait for each other, a hundred times as long as the work takes.
    count = min(count, os.cpu_count() or 1)
    if "eofm.compiled" in sys.modules:
        from eofm import compiled

        compiled.use_threads(count)
    else:  # read when it is imported, which takes a while
        os.environ["NUMBA_NUM_THREADS"] = str(count)


def serial(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate what calls BLAS for many small matrices, so that it takes one thread.

    Several would wait for each other most of the time, and the result would depend on their
    number.
    """

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return run


@cache
def _libraries() -> ThreadpoolController:
    """Those that are loaded, which takes as long to find out as a small matrix to factorise."""
    return ThreadpoolController()
