"""The table of samples of a run that failed: of rows whose job was killed it says so.

Jobs that reach a limit of time or memory, or whose node dies, write nothing themselves.
"""

import re
import sys
from pathlib import Path
from typing import Any

from sample_rows import READY, STATE, crashed, kept
from samples_page import CSV, write

# What an executor says of a job of rows, and where the table says which job it was.
SAID = re.compile(r"Error in rule (\w*samples_\d+):\n(?:    (?!message).*\n)*    message: (.*)")
# Rows that are named on the screen.
NAMED = 20


def write_what_is_left(rows: dict[str, str], folder: Path, logs: list[str]) -> None:
    """Write the table of all rows, and name those without results on standard error.

    Parameters
    ----------
    rows : dict
        Of each row the name of the rule that runs it.
    folder : Path
        Folder of the folders of results.
    logs : list of str
        Logs of the run, with what was said of its jobs.
    """
    text = "".join(Path(log).read_text(errors="replace") for log in logs)
    said = {rule: _reason(message) for rule, message in SAID.findall(text)}
    states = [_state(name, folder, said.get(rule, "")) for name, rule in rows.items()]
    folder.mkdir(parents=True, exist_ok=True)
    write(states, folder)
    left = [state for state in states if state["state"] != READY]
    for state in left[:NAMED]:
        print(f"{state['sample']}: {state['state']}: {state['reason']}", file=sys.stderr)
    more = f"; {folder / CSV} names all" if len(left) > NAMED else ""
    print(f"{len(left)} of {len(states)} samples have no results{more}", file=sys.stderr)


def _state(name: str, folder: Path, said: str) -> dict[str, Any]:
    if state := kept(folder / name) or kept(folder / name, STATE):
        return state
    because = f" ({said})" if said else ""
    return {"sample": name} | crashed(f"its job ended before it was done{because}")


def _reason(message: str) -> str:
    """The first sentence of what an executor says."""
    return message.partition(". ")[0].rstrip(".")
