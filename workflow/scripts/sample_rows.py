"""Rows of the table of samples, one after the other in one process.

A row that cannot be used, ends the process or takes too long costs only itself. Rows whose results
are there and come from the same options, files and code are left as they are; rows that crashed,
which need not be their fault, are tried again by the next run.

Snakemake removes the states of all rows of a job that was killed, so each row keeps a copy.
"""

import contextlib
import hashlib
import json
import os
import signal
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection, get_context, parent_process
from pathlib import Path
from typing import Any

STATE, KEPT = "state.json", ".state.json"
# Exit statuses of the step with results.
DONE, NOT_TRUSTED = 0, 3
# Exit status of wrong usage.
WRONG = 2
ENDED = "its process ended, perhaps for want of memory"
# States of rows whose results are there, which cannot have any, and which may have them next time.
READY, UNUSABLE, CRASHED = "done", "unusable", "crashed"


def run_rows(rows: dict[str, dict[str, Any]], folder: Path, code: list[str], threads: int) -> None:
    """Run rows and write a state for each.

    Parameters
    ----------
    rows : dict
        Of each sample its `words`, of the step's command line, its `files`, its `log`, and the
        `seconds` that it may take.
    folder : Path
        Folder of the folders of results.
    code : list of str
        Files behind the step.
    threads : int
        Cores to use.
    """
    made_by = [_checksum(file) for file in code]
    pool = _pool()
    for name, row in rows.items():
        place = folder / name
        place.mkdir(parents=True, exist_ok=True)
        key = _key(row["words"], row["files"], made_by)
        if _has_results(place, key):
            if not (place / STATE).exists():
                _write(place / STATE, kept(place))
            continue
        for file in (STATE, KEPT):
            (place / file).unlink(missing_ok=True)
        Path(row["log"]).parent.mkdir(parents=True, exist_ok=True)
        words = ["sample", f"--folder={place}", f"--threads={threads}", *row["words"]]
        started = time.monotonic()
        try:
            status = pool.submit(_run, place, words, row["log"], row["seconds"]).result()
        except BrokenProcessPool:
            late = time.monotonic() - started >= row["seconds"]
            _say(name, row, f"took longer than {row['seconds']} s" if late else ENDED)
            status, pool = None, _pool()
        state = {"sample": name} | state_of(status, place, Path(row["log"]))
        state |= {"seconds": round(time.monotonic() - started, 2), "key": key}
        for file in (KEPT, STATE):
            _write(place / file, state)
    pool.shutdown()


def kept(place: Path, name: str = KEPT) -> dict[str, Any]:
    """What a row says of itself, also where its job was killed later; nothing if it did not end."""
    try:
        return json.loads((place / name).read_text())
    except (OSError, ValueError):
        return {}


def _pool() -> ProcessPoolExecutor:
    """A process for rows, which Ctrl-C does not meet while it starts: its parent ends it."""
    pool = ProcessPoolExecutor(1, get_context("spawn"), initializer=_end_with_parent)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    pool.submit(os.getpid)
    signal.signal(signal.SIGINT, before)
    return pool


def _end_with_parent() -> None:
    """Do not go on in a folder that another run may use once the parent was killed."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _run(place: Path, words: list[str], log: str, seconds: int) -> int | None:
    """Run the step with all that it says in a log; None is for what may work next time."""
    from eofm.analysis.report import RESULTS
    from eofm.app.cli import in_words, parser, run
    from eofm.errors import InputError

    # Nothing old is to be taken for new.
    for name in RESULTS:
        (place / name).unlink(missing_ok=True)

    # Ends this process even where compiled code never returns.
    signal.alarm(seconds)
    with open(log, "w", buffering=1) as file, contextlib.redirect_stderr(file):
        try:
            return run(parser().parse_args(words))
        except SystemExit as error:  # wrong usage, or SIGTERM
            return error.code if error.code == WRONG else None
        except InputError as error:
            print(f"eofm sample: {error}", file=file)
            return 1
        except (OSError, MemoryError) as error:
            print(f"eofm sample: {in_words(error)}", file=file)
            return None
        except Exception as error:
            print(f"eofm sample: {type(error).__name__}: {error}", file=file)
            return 1
        finally:
            signal.alarm(0)


def _say(name: str, row: dict[str, Any], what: str) -> None:
    Path(row["log"]).write_text(f"eofm sample: {name}: {what}\n")


def state_of(status: int | None, place: Path, log: Path) -> dict[str, Any]:
    """What a row of the summary says of a sample."""
    said = log.read_text() if log.exists() else ""
    reason = " ".join(said.split()).removeprefix("eofm sample: ").removeprefix(f"{place.name}: ")
    if status is None:
        return crashed(reason)
    if status not in (DONE, NOT_TRUSTED):
        return {"state": UNUSABLE, "reason": reason}
    summary = json.loads((place / "summary.json").read_text())
    order = ("good", "doubtful", "failed")
    trust = max(summary["trust"], key=lambda step: order.index(step["verdict"]))
    figures = {
        "width_px": summary["size_px"][0],
        "height_px": summary["size_px"][1],
        "u1_least_px": summary["u1_range_px"][0],
        "u1_most_px": summary["u1_range_px"][1],
        "u2_least_px": summary["u2_range_px"][0],
        "u2_most_px": summary["u2_range_px"][1],
        "axial_strain_mean": summary["axial_strain_mean"],
        # Tiles are not estimated backwards.
        "forward_backward_error_median_px": summary.get("forward_backward_error_median_px"),
    }
    return {
        "state": READY,
        "reason": "; ".join(trust.get("reasons", [])),
        "verdict": trust["verdict"],
        **figures,
    }


def crashed(reason: str) -> dict[str, Any]:
    """What is said of a row that may work next time."""
    return {"state": CRASHED, "reason": f"{reason}; the next run tries it again"}


def _has_results(place: Path, key: str) -> bool:
    state = kept(place)
    wanted = state.get("state") != READY or (place / "summary.json").is_file()
    return state.get("key") == key and state.get("state") != CRASHED and wanted


def _key(words: list[str], files: list[str], made_by: list[str]) -> str:
    read = {file: _checksum(file) for file in files if os.path.isfile(file)}
    return hashlib.sha256(json.dumps([words, read, made_by]).encode()).hexdigest()


def _checksum(file: str) -> str:
    with open(file, "rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def _write(path: Path, state: dict[str, Any]) -> None:
    temporary = path.with_name(f"{path.name}.tmp")
    try:
        temporary.write_text(json.dumps(state, indent=1) + "\n")
        temporary.replace(path)
    except OSError as error:
        raise OSError(f"{path}: cannot be written ({error.strerror})") from None
