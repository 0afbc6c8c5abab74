"""One step of a volume in tiles, as a job of its own.

A volume that cannot be used costs only its row: the step that finds out says so in what it was to
write, and the steps after it pass it on to the table of samples. A step that the machine failed
ends as an error, and the next run tries it again.
"""

import contextlib
import json
import sys
import time
from pathlib import Path

from sample_rows import DONE, STATE, UNUSABLE, WRONG, state_of

REFUSED = "refused"
# What the first step says of when it began.
BEGUN = "begun"


def refused(files: list[str]) -> str | None:
    """Why an earlier step has refused the row."""
    for file in files:
        if file.endswith(".json"):
            said = json.loads(Path(file).read_text())
            if REFUSED in said:
                return str(said[REFUSED])
    return None


def run_step(words: list[str], log: Path) -> str | None:
    """Run a step with all that it says in a log; return why the row cannot be used."""
    from eofm.app.cli import parser, run
    from eofm.errors import InputError

    log.parent.mkdir(parents=True, exist_ok=True)
    said = contextlib.ExitStack()
    with said:
        file = said.enter_context(log.open("w", buffering=1))
        said.enter_context(contextlib.redirect_stderr(file))
        said.enter_context(contextlib.redirect_stdout(file))
        try:
            run(parser().parse_args(words))
        except SystemExit as error:
            if error.code != WRONG:
                raise
            return log.read_text().strip().splitlines()[-1].partition("error: ")[2]
        except InputError as error:
            print(error, file=file)
            return str(error)
    return None


def pass_on(outputs: list[str], reason: str) -> None:
    """Write the reason instead of results."""
    for output in outputs:
        path = Path(output)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({REFUSED: reason}) + "\n" if path.suffix == ".json" else "")


def write_state(path: Path, log: Path, reason: str | None, seconds: float) -> None:
    """Say what a row of the table of samples says."""
    name = path.parent.name
    if reason is None:
        state = state_of(DONE, path.parent, log)
    else:
        state = {"state": UNUSABLE, "reason": reason}
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text(f"eofm gather: {name}: {reason}\n")
    path.parent.mkdir(parents=True, exist_ok=True)
    state = {"sample": name} | state | {"seconds": round(seconds, 2)}
    path.write_text(json.dumps(state, indent=1) + "\n")


def main(words: list[str], inputs: list[str], outputs: list[str], log: Path) -> None:
    """Run a step, or pass on that the row was refused."""
    work = Path(
        next(f for f in [*outputs, *inputs] if f.endswith(".json") and STATE not in f)
    ).parent
    begun = work / BEGUN
    if words[0] == "coarse":
        work.mkdir(parents=True, exist_ok=True)
        begun.touch()
    reason = refused(inputs) or run_step(words, log)
    if STATE in outputs[0]:
        write_state(Path(outputs[0]), log, reason, time.time() - begun.stat().st_mtime)
    elif reason is not None:
        pass_on(outputs, reason)


if __name__ == "__main__":
    try:
        main(
            [*snakemake.params.words, f"--threads={snakemake.threads}"],
            [str(f) for f in snakemake.input.get("made", [])],
            [str(f) for f in snakemake.output],
            Path(snakemake.log[0]),
        )
    except OSError as error:
        sys.exit(str(error))
