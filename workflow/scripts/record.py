"""Measured numbers that texts quote, one small file each: values, date, command and machine."""

import datetime
import json
import os
import platform
from pathlib import Path
from typing import Any

import pandas as pd

from eofm import io


def record(path: Path, command: str, values: dict[str, Any]) -> None:
    """Write values with the day, the command that gave them, and the machine."""
    io.write_json(path, _where(command) | {"values": values})


# What a file says of its command where each part has its own.
OWN = "each part says its own"


def record_part(path: Path, part: str, command: str, values: dict[str, Any]) -> None:
    """Write the values of one part of a file; the others stay."""
    parts = recorded(path) | {part: _where(command) | values}
    record(path, OWN, dict(sorted(parts.items())))


def recorded(path: Path) -> dict[str, Any]:
    """Values of a file of numbers; none where it is missing."""
    return json.loads(path.read_text())["values"] if path.exists() else {}


def _where(command: str) -> dict[str, Any]:
    date = datetime.date.today().isoformat()
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return {"date": date, "command": command, "machine": machine}


def rows(path: str | Path, name: str) -> dict[str, dict[str, Any]]:
    """Rows of a table as dictionaries without empty cells, by what stands in a column."""
    table = pd.read_csv(path, dtype={name: str}).set_index(name)
    return {key: row.dropna().to_dict() for key, row in table.iterrows()}
