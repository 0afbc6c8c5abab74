"""Kernels are compiled once for all processes, and shared among any number of threads."""

import os
import subprocess
import sys

import numpy as np

from eofm.compiled import SERIAL, share, use_threads

MODULE = """
from typing import NamedTuple
from eofm.compiled import compiled

class Line(NamedTuple):
    slope: float

@compiled
def fill(first, last, a, line):
    for i in range(first, last):
        a[i] = line.slope * i
"""
RUN = """
import numpy as np, kernel
a = np.empty(5)
kernel.fill(0, 5, a, kernel.{name}(2.0))
assert a.tolist() == [0, 2, 4, 6, 8]
print(kernel.fill.stats.cache_hits)
"""


def start(folder, name="Line"):
    paths = os.pathsep.join([str(folder), *sys.path])
    return subprocess.Popen(
        [sys.executable, "-c", RUN.format(name=name)],
        env=os.environ | {"PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(folder / "cache")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_processes_that_start_together_compile_once_and_say_so(tmp_path):
    (tmp_path / "kernel.py").write_text(MODULE)
    first = [start(tmp_path) for _ in range(2)]
    outputs = [process.communicate() for process in first]
    assert "".join(error for _, error in outputs).count("compiling") == 1
    # numba counts by signature: one of them found the machine code of the other.
    assert sorted("1" in output for output, _ in outputs) == [False, True]
    output, error = start(tmp_path).communicate()
    assert "1" in output
    assert not error


def test_machine_code_for_a_class_of_another_version_is_replaced(tmp_path):
    (tmp_path / "kernel.py").write_text(MODULE)
    start(tmp_path).communicate()
    (tmp_path / "kernel.py").write_text(MODULE.replace("Line", "Ray"))
    output, error = start(tmp_path, "Ray").communicate()
    assert "compiling" in error
    assert "Traceback" not in error
    assert output


def test_each_row_is_done_once_by_any_number_of_threads():
    def count(first, last, done):
        done[first:last] += 1

    for threads in (1, 2, 3, 8):
        use_threads(threads)
        for rows in (1, 5, 64):
            for work in (1, SERIAL):
                done = np.zeros(rows)
                share(count, rows, work, done)
                assert (done == 1).all()
