"""Time and memory of runs in this process, on one thread.

Not all tools can use several threads, and none has to: pairs of images are run side by side.
Time is that of the processor, which other programs hardly change.
"""

import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from threadpoolctl import threadpool_limits

from eofm.compiled import use_threads

use_threads(1)
threadpool_limits(1)

T = TypeVar("T")

# Runs are repeated until they have taken so many seconds together, or so often; at least twice,
# for the first touch of memory can take longer than the run, but for runs of more than a minute.
LONG, OFTEN, MINUTE = 2.0, 5, 60.0


def peak() -> float:
    """Largest memory that this process has taken so far, MB (Linux)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def resident() -> float:
    """Memory that this process holds now, MB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def measure(
    run: Callable[[], T], idle: float, clock: Callable[[], float] = time.process_time
) -> tuple[T, dict[str, float]]:
    """What a run returns; its least time and how far its peak lies above ``idle``, MB.

    Importing and compiling have to be over by then: run something small before.
    """
    times: list[float] = []
    while len(times) < 2 or (sum(times) < LONG and len(times) < OFTEN):
        result = None  # or the peak would hold two
        start = clock()
        result = run()
        times.append(clock() - start)
        if times[0] > MINUTE:
            break
    return result, {"seconds": min(times), "peak_mb": peak() - idle}
