"""Command lines of the steps: options that state settings, and rows of the table of samples."""

import io
import json
import os
import re
import shlex
from difflib import get_close_matches
from pathlib import Path

import pandas as pd

from eofm.app.steps import ANALYSIS
from eofm.errors import InputError
from eofm.grid import FACES
from eofm.settings import Section, Tiling

# Letters of a wrong name that a message repeats.
LONGEST = 60


def options(*sections: Section) -> str:
    """Command-line options that state all values of some sections."""
    words = []
    for section in sections:
        for name, value in section.model_dump(mode="json").items():
            words.append(f"--{name.replace('_', '-')}")
            if value is None:
                value = "none"
            words += [
                item if isinstance(item, str) else json.dumps(item)
                for item in (value if isinstance(value, list) else [value])
            ]
    return shlex.join(words)


def read_samples(path: str) -> dict[str, dict[str, str]]:
    """Rows of the table of samples by name, as texts, without empty cells.

    Raises
    ------
    InputError
        In one line: what is wrong with the table, and what to do.
    """
    table = _read_table(path)
    sections = (*ANALYSIS, Tiling)
    known = ["sample", "settings", *(key for section in sections for key in section.model_fields)]
    for column in table:
        if column not in known:
            close = get_close_matches(column, known, 1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise InputError(f"{path}: unknown column {column[:LONGEST]}{hint}")
    if "sample" not in table:
        raise InputError(f"{path}: lacks the column sample")
    for name in table["sample"]:
        if not re.fullmatch(r"[\w-][\w.-]*", name):
            raise InputError(
                f"{path}: sample '{name[:LONGEST]}': use letters, digits, dots, - and _ in names"
            )
        if (table["sample"] == name).sum() > 1:
            raise InputError(f"{path}: sample {name} stands in it twice; rename one")
    rows = table.to_dict("records")
    return {row.pop("sample"): {k: v for k, v in row.items() if v.strip()} for row in rows}


def _read_table(path: str) -> pd.DataFrame:
    try:
        # Only whole lines are comments: FILE#3 is page 3 of a file.
        lines = [line for line in Path(path).read_text().splitlines() if line[:1] != "#"]
        for number, line in enumerate(lines):
            if line.count("\t") > lines[0].count("\t"):
                raise ValueError(f"row {number} has more cells than the table has columns")
        text = io.StringIO("\n".join(lines))
        return pd.read_csv(text, sep="\t", dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a table ({error})") from None


def sample_words(row: dict[str, str]) -> list[str]:
    """Options of a row of the table of samples."""
    # One word per cell: the step splits those of several values, so that none is an option.
    return [f"--{name.replace('_', '-')}={text}" for name, text in row.items()]


def sample_files(row: dict[str, str]) -> list[str]:
    """Files that a row names, but those that are not there: the step says so in one line."""
    keys = ("reference", "deformed", "frames", "mask", "settings", "background")
    names = [row.get(key, "") for key in keys]
    # The file is the last word: moved FILE, outside moved FILE.
    names += [row.get(edge, "").rpartition(" ")[2] for edge in FACES]
    files = [name.partition("#")[0] for name in names if name]
    return [f for f in files if f.startswith("results/") or os.path.isfile(f)]
