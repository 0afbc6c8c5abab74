"""Measure what docs/reliability.md says of batches, of resources and of tests; and record it.

    python workflow/scripts/reliability.py batch
    python workflow/scripts/reliability.py tests
    python workflow/scripts/reliability.py resources

The last one compares what `parts.py` says that samples take with what they do. The counts of the
fuzz are recorded by tests/fuzz/fuzz.py.
"""

import argparse
import contextlib
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from commands import read_samples
from parts import Size, memory, parts, seconds, size
from record import record_part

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "docs/figures/reliability.json"
# Rows of the table that is planned, and the images that are analysed, px.
ROWS, HEIGHT, WIDTH = 500, 100, 180
# Samples whose memory and time are compared, px.
SHAPES = (128, 128), (256, 256), (512, 512), (1024, 1024), (32, 32, 32), (64, 64, 64)
# Tests of what must not be lost, and of what may happen to a run.
TESTED = ["tests/faults", "tests/app/test_faults.py", "tests/app/test_extremes.py"]
TESTED += ["tests/io/test_hostile.py", "tests/workflow/test_slurm.py"]


def batch() -> dict[str, Any]:
    """Time of planning many rows, and of one sample in a process at work and by the command."""
    import eofm
    from eofm import io
    from eofm.app.cli import main

    u = np.zeros((2, HEIGHT, WIDTH))
    u[1] = -0.02 * np.arange(HEIGHT)[:, None]
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        shutil.copytree(ROOT / "config", "config")
        for name, I in zip("ab", eofm.make_phantom(u, eofm.Phantom(count=200)), strict=False):
            io.write_image(Path(f"{name}.tif"), I)
        lines = ["sample\treference\tdeformed\troi"]
        lines += [f"r{k}\ta.tif\tb.tif\t0 0 {WIDTH} {HEIGHT - k % 50}" for k in range(ROWS)]
        Path("config/samples.tsv").write_text("\n".join(lines) + "\n")
        plan = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile")]
        plan += ["--profile", str(ROOT / "profiles/default"), "--dry-run", "samples"]
        values = {"rows": ROWS, "plan_seconds": _of_child(plan)}
        words = ["sample", "--reference=a.tif", "--deformed=b.tif", "--threads=1"]
        for figures in ("none", "png"):
            more = [*words, f"--figures={figures}"]
            main([*more, "--folder=warm"])
            times = []
            for _ in range(3):
                started = time.process_time()
                main([*more, f"--folder={figures}"])
                times.append(time.process_time() - started)
            values[f"sample_seconds_{figures}"] = round(min(times), 2)
            command = [sys.executable, "-m", "eofm.app.cli", *more, f"--folder={figures}"]
            values[f"command_seconds_{figures}"] = _of_child(command)
    return values


def _of_child(command: list[str]) -> float:
    """Time of the processor that a command takes the second time, s."""
    for _ in range(2):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        env = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        subprocess.run(command, env=env, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 2)


def tests() -> dict[str, Any]:
    """How many tests there are of faults, of hostile files, and of extreme values."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-o", "addopts="]
    done = subprocess.run([*command, *TESTED], cwd=ROOT, capture_output=True, text=True, check=True)
    counts = {path: done.stdout.count(f"{path}{'/' * path.endswith('faults')}") for path in TESTED}
    corpus = len(list((ROOT / "tests/fuzz/corpus").iterdir()))
    return {Path(path).stem: count for path, count in counts.items()} | {"corpus": corpus}


def compare(folder: Path, table: str) -> list[dict[str, float]]:
    """What `parts.py` says of each part of a run over what its benchmark file shows."""
    with contextlib.chdir(folder):
        rows, found = read_samples(table), []
        samples = {name: row for name, row in rows.items() if "tiles" not in row}
        for number, names in enumerate(parts(samples)):
            took = pd.read_csv(f"benchmarks/samples_{number}.tsv", sep="\t").iloc[-1]
            sizes = [size(samples[name]) for name in names]
            ratios = memory(sizes) / took.max_rss, seconds(sizes) / took.s
            found.append(dict(zip(("mb", "seconds"), ratios, strict=True)))
    return found


def resources() -> dict[str, Any]:
    """What samples of several sizes take, and what `parts.py` says of them."""
    values: dict[str, Any] = {"sizes": {}}
    for shape in SHAPES:
        with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
            took = _sample(shape)
        of = [Size(int(np.prod(shape)), len(shape))]
        said = {"mb": memory(of), "seconds": seconds(of)}
        ratios = {f"{key}_ratio": round(said[key] / took[key], 2) for key in said}
        values["sizes"]["x".join(map(str, shape))] = took | ratios
        print(shape, took, ratios, flush=True)
    for key in ("mb_ratio", "seconds_ratio"):
        ratios = [of[key] for of in values["sizes"].values()]
        values[key] = {"least": min(ratios), "most": max(ratios)}
    return values


def _sample(shape: tuple[int, ...]) -> dict[str, float]:
    """Memory, MB, and time of the processor, s, of a sample on one thread."""
    import eofm
    from eofm import io

    u = np.zeros((len(shape), *shape))
    u[1] = -0.01 * np.arange(shape[-2])[:, None]
    look = eofm.Phantom(count=int(np.prod(shape)) // 60)
    for name, I in zip("ab", eofm.make_phantom(u, look), strict=False):
        io.write_image(Path(f"{name}.tif"), I)
    code = "import resource, sys; from eofm.app.cli import main; main(sys.argv[1:])\n"
    code += "used = resource.getrusage(resource.RUSAGE_SELF)\n"
    code += "print(used.ru_maxrss / 1024, used.ru_utime + used.ru_stime)"
    words = ["sample", "--reference=a.tif", "--deformed=b.tif", "--folder=c", "--threads=1"]
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", code, *words]
    done = subprocess.run(command, env=env, check=True, capture_output=True, text=True)
    mb, time_taken = map(float, done.stdout.split()[-2:])
    return {"mb": round(mb), "seconds": round(time_taken, 1)}


def main() -> None:
    """Measure and record one part."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("part", choices=["batch", "tests", "resources"])
    part = parser.parse_args().part
    values = {"batch": batch, "tests": tests, "resources": resources}[part]()
    record_part(RECORD, part, f"python workflow/scripts/reliability.py {part}", values)


if __name__ == "__main__":
    main()
