"""Damaged files for every reader: one clear line each, or a result; no crash, no hang.

    python tests/fuzz/fuzz.py --count 1000000 --cores 2

A seed and a number are a file; ``--first`` goes on from a number, and ``--record`` adds to the
figures of the files before. Each core reads in a process of its own, which is watched: where it
ends, hangs for ten seconds or takes more than a gibibyte, the file counts as found and is kept in
the folder ``found``. Move what was mended to ``tests/fuzz/corpus``; the tests read all that is
there.
"""

import argparse
import logging
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[1])]
sys.path += [str(Path(__file__).parents[2] / "workflow/scripts")]

import seeds
from commands import read_samples, sample_files, sample_words
from record import record_part, recorded

from eofm import io
from eofm.errors import InputError
from eofm.io import dicom, formats, hdf5, matlab, nifti, omezarr

SECONDS, MEMORY, IMAGE = 10, 1 << 30, 1 << 26
# Libraries hang and crash, that for HDF5 the most; so many ends are tried in its own process.
APART_SECONDS, CONTAINED = 2, 20
# Shares of the kinds: those that trust a file's lengths most often come most often.
SHARES = {".tif": 30, ".mat": 20, ".png": 10, ".npy": 10, ".npz": 6, ".csv": 8, ".yaml": 4}
SHARES |= {".tsv": 4, ".mha": 6, ".nrrd": 6, ".oct": 6, "hdf5": 2, "nifti": 2, "dicom": 2}
SHARES |= {"zarr": 1}
# Those that the command reads in a child, by the modules that do.
APART = {"hdf5": hdf5, "nifti": nifti, "dicom": dicom, "zarr": omezarr}
ENDINGS = {"hdf5": ".mat", "nifti": ".nii", "dicom": ".dcm", "zarr": ".zip"}
LONGEST = 700


def read(kind: str, path: Path) -> None:
    """Read a file by the reader of a kind, and check what it returns."""
    if kind == ".csv":
        assert np.isfinite(io.read_bubbles(path)[list(io.BUBBLE_COLUMNS)].to_numpy()).all()
    elif kind == ".yaml":
        io.read_settings(path)
    elif kind == ".tsv":
        for row in read_samples(str(path)).values():
            assert all(word.startswith("--") for word in sample_words(row))
            sample_files(row)
    elif kind in APART:
        # Without the child a crash shows in this process.
        try:
            APART[kind].read(str(unpacked(path)), "", IMAGE)
        except Exception as error:  # as the child does
            raise InputError(" ".join(str(error).split())[:200]) from None
    else:
        I = io.read_image(path)
        assert (I.ndim, I.dtype) in ((2, np.float64), (3, np.float32))
        assert np.isfinite(I).all()


def unpacked(path: Path) -> Path:
    """A file, or the folder that is packed in it."""
    if path.suffix != ".zip":
        return path
    folder = path.with_suffix(".zarr")
    shutil.rmtree(folder, ignore_errors=True)
    for name, data in seeds.members(path.read_bytes()).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def damaged(kinds: dict[str, list[bytes]], seed: int, number: int) -> tuple[str, bytes]:
    """The damaged file of a number."""
    random = Random(f"{seed} {number}")
    (kind,) = random.choices(list(SHARES), list(SHARES.values()))
    return kind, seeds.damaged(kind, kinds[kind], random)


def work(seed: int, first: int, step: int, stop: int, say: Connection) -> None:
    """Read every ``step``-th damaged file from the ``first`` on, and say what happens."""
    warnings.simplefilter("ignore")
    logging.disable()
    io.limit_size(IMAGE / 2**30)
    kinds = seeds.make()
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    shared = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=shared) as folder:
        for number in range(first, stop, step):
            kind, data = damaged(kinds, seed, number)
            path = Path(folder, f"f{ENDINGS.get(kind, kind)}")
            path.write_bytes(data)
            say.send((number, None, None))
            signal.alarm(APART_SECONDS if kind in APART else SECONDS)
            outcome, fault = _outcome(kind, path)
            signal.alarm(0)
            say.send((number, (kind, outcome), fault))
    say.send((None, None, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss))


def _outcome(kind: str, path: Path) -> tuple[str, str | None]:
    """Whether a file was read, refused or makes a fault, and that."""
    try:
        read(kind, path)
    except InputError as error:
        text = str(error)
        if "\n" in text or len(text) > LONGEST or "not enough memory" in text:
            return "fault", f"says {text[:LONGEST]!r}"
        return "refused", None
    except BaseException:
        return "fault", traceback.format_exc(limit=-3)
    return "read", None


def fuzz(
    numbers: range, cores: int, seed: int, found: Path, show: Callable[[str], Any] = print
) -> tuple[Counter, list[str]]:
    """Read the damaged files of some numbers.

    Returns how many of each kind were read or refused, and the faults.
    """
    context = multiprocessing.get_context("spawn")
    kinds, results, faults, most = seeds.make(), Counter(), [], 0
    running: dict[Connection, list] = {}

    def start(first: int) -> None:
        hear, say = context.Pipe(duplex=False)
        child = context.Process(target=work, args=(seed, first, cores, numbers.stop, say))
        child.start()
        say.close()
        running[hear] = [child, first]

    def note(number: int, fault: str) -> None:
        kind, data = damaged(kinds, seed, number)
        contained = kind in APART and fault.startswith("ends")
        if fault.startswith("ends"):
            results[kind, "contained" if contained else "fault"] += 1
        found.mkdir(parents=True, exist_ok=True)
        name = f"{'contained' if contained else 'fault'}_{seed}_{number}"
        path = found / f"{name}{ENDINGS.get(kind, kind)}"
        path.write_bytes(data)
        if contained:
            fault = _contained(path) if results[kind, "contained"] <= CONTAINED else ""
        if fault:
            faults.append(f"{path}: {fault}")
            show(faults[-1])

    for first in numbers[:cores]:
        start(first)
    while running:
        for hear in multiprocessing.connection.wait(list(running)):
            child, number = running[hear]
            try:
                number, outcome, said = hear.recv()
            except EOFError:
                child.join()
                del running[hear]
                if child.exitcode:
                    note(number, f"ends its process by {child.exitcode}")
                    start(number + cores)
                continue
            if number is None:
                most = max(most, said)
                continue
            running[hear][1] = number
            if outcome:
                results[outcome] += 1
            if said:
                note(number, said)
    show(f"at most {most / 2**10:.0f} MiB of memory")
    return results, faults


def _contained(path: Path) -> str:
    """What is wrong with the line that the command has for a file that ends its reader."""
    formats.PATIENCE = matlab.PATIENCE = APART_SECONDS
    try:
        io.read_image(unpacked(path))
    except InputError as error:
        return "" if "\n" not in str(error) else "more than one line"
    return ""  # what ends the process now and then may be read at other times


def note(
    path: Path, seed: int, numbers: range, results: Counter, faults: list[str], again: str
) -> None:
    """Add the counts of some files to those of the files before them, in a file of figures."""
    before = recorded(path).get("fuzz", {}) if numbers.start else {}
    if before.get("seed", seed) != seed or before.get("files", 0) != numbers.start:
        raise SystemExit(f"{path}: does not end with file {numbers.start - 1} of the seed {seed}")
    values = {"seed": seed, "files": numbers.stop, "faults": len(faults) + before.get("faults", 0)}
    for outcome in ("read", "refused", "contained"):
        values[outcome] = sum(n for (_, o), n in results.items() if o == outcome)
        values[outcome] += before.get(outcome, 0)
    kinds = Counter(before.get("kinds", {}))
    for (kind, _), number in results.items():
        kinds[kind.removeprefix(".")] += number
    record_part(path, "fuzz", again, values | {"kinds": dict(sorted(kinds.items()))})


def main() -> int:
    """Run from the command line; 1 if anything was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="number of the first file")
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--found", type=Path, default=Path("found"))
    parser.add_argument("--record", type=Path, help="JSON file of figures to add the counts to")
    args = parser.parse_args()
    started = time.monotonic()
    numbers = range(args.first, args.first + args.count)
    results, faults = fuzz(numbers, args.cores, args.seed, args.found)
    if args.record:
        again = f"python tests/fuzz/fuzz.py --count {numbers.stop} --seed {args.seed}"
        note(args.record, args.seed, numbers, results, faults, again)
    for (kind, outcome), number in sorted(results.items()):
        print(f"{kind:6} {outcome:10} {number}")
    print(f"{args.count} files in {time.monotonic() - started:.0f} s, {len(faults)} faults")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
