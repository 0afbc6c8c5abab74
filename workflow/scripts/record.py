"""Measured numbers that texts quote, one small file each: values, date, command and machine."""

import datetime
import os
import platform
from pathlib import Path
from typing import Any

import pandas as pd

from eofm import io


def record(path: Path, command: str, values: dict[str, Any]) -> None:
    """Write values with the day, the command that gave them, and the machine."""
    date = datetime.date.today().isoformat()
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    io.write_json(path, {"date": date, "command": command, "machine": machine, "values": values})


def rows(path: str | Path, name: str) -> dict[str, dict[str, Any]]:
    """Rows of a table as dictionaries without empty cells, by what stands in a column."""
    table = pd.read_csv(path, dtype={name: str}).set_index(name)
    return {key: row.dropna().to_dict() for key, row in table.iterrows()}
