"""How many threads libraries take."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")


def serial(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate what calls BLAS for many small matrices, so that it takes one thread.

    Several would wait for each other most of the time, and the result would depend on their
    number.
    """

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return run
