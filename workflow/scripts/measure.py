"""Time and memory of runs in this process, on one thread.

Not all tools can use several threads, and none has to: pairs of images are run side by side.
Time is that of the processor, which other programs hardly change.
"""

import resource
import time
from collections.abc import Callable
from typing import TypeVar

from threadpoolctl import threadpool_limits

from eofm.compiled import use_threads

use_threads(1)
threadpool_limits(1)

T = TypeVar("T")

# Runs are repeated until they have taken so many seconds together, or so often; at least twice,
# for the first touch of memory can take longer than the run.
LONG, OFTEN = 2.0, 5


def peak() -> float:
    """Largest memory that this process has taken so far, MB (Linux)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure(run: Callable[[], T], idle: float) -> tuple[T, dict[str, float]]:
    """What a run returns; its least time and how far its peak lies above ``idle``, MB.

    Importing and compiling have to be over by then: run something small before.
    """
    times: list[float] = []
    while len(times) < 2 or (sum(times) < LONG and len(times) < OFTEN):
        result = None  # or the peak would hold two
        start = time.process_time()
        result = run()
        times.append(time.process_time() - start)
    return result, {"seconds": min(times), "peak_mb": peak() - idle}
