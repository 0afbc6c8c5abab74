"""Tables as CSV, settings as YAML, summaries as JSON."""

import json
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from eofm.errors import InputError
from eofm.io import origin
from eofm.io.formats import check_is_file, one_line
from eofm.io.limits import LARGEST_TEXT, check_size
from eofm.io.places import check_place, remove, replacing

if TYPE_CHECKING:
    import pandas as pd

BUBBLE_COLUMNS = ("x1", "x2", "u1", "u2")


def read_bubbles(path: str | Path) -> "pd.DataFrame":
    """Read a table of bubbles with at least the columns x1, x2, u1, u2, px.

    Parameters
    ----------
    path : str or Path
        CSV.

    Raises
    ------
    InputError
        See `read_columns`.
    """
    return read_columns(path, BUBBLE_COLUMNS)


def read_columns(path: str | Path, columns: tuple[str, ...]) -> "pd.DataFrame":
    """Read a CSV table that has at least some columns of numbers.

    Parameters
    ----------
    path : str or Path
    columns : tuple of str

    Raises
    ------
    InputError
        If the file is missing, is no table, lacks a column, holds something else than finite
        numbers in it, or is not what was written.
    """
    import pandas as pd  # takes a quarter of a second that images alone do not need

    path = Path(path)
    check_is_file(str(path), "a CSV table")
    check_size(str(path), [os.path.getsize(path)], 1)
    _check_unchanged(path)
    try:
        with origin.reading(path):
            table = pd.read_csv(path, compression=None)
    except InputError:
        raise
    # Of a damaged table, the parser also raises what says little of tables.
    except Exception as error:
        raise InputError(f"{path}: cannot be read as a CSV table ({one_line(error)})") from None
    if not isinstance(table.index, pd.RangeIndex):
        raise InputError(f"{path}: its rows have more cells than its header; mend it")
    missing = [name for name in columns if name not in table]
    if missing:
        raise InputError(
            f"{path}: lacks the column {missing[0]}; wanted are the columns {', '.join(columns)}"
        )
    for name in columns:
        if f"{name}.1" in table:
            raise InputError(f"{path}: has the column {name} twice; delete one")
        column = table[name].map(_number).astype(float)
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise InputError(
                f"{path}: {name} in line {bad[0] + 2} is no finite number; mend or delete the line"
            )
        table[name] = column
    return table


def _number(cell: Any) -> float:
    """The number in a cell, or NaN; truth values are none."""
    try:
        return math.nan if isinstance(cell, bool | np.bool_) else float(cell)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def write_table(path: str | Path, table: "pd.DataFrame") -> None:
    """Write a table as CSV, with six decimals, and its checksum beside it.

    Parameters
    ----------
    path : str or Path
    table : DataFrame
    """
    path = check_place(path, "CSV")
    origin.check_not_read(path)
    # Between the two there is no checksum rather than a wrong one.
    beside = _beside(path)
    remove(beside)
    with replacing(path) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6f", lineterminator="\n")
        digest = origin.checksum(temporary)
    with replacing(beside) as temporary:
        temporary.write_text(f"{digest}  {path.name}\n")


def _beside(path: Path) -> Path:
    return path.with_name(f"{path.name}.sha256")


def _check_unchanged(path: Path) -> None:
    """Refuse a table that is not the one whose checksum stands beside it."""
    beside = _beside(path)
    if beside.is_file() and beside.read_bytes()[:64] != origin.checksum(path).encode():
        raise InputError(
            f"{path}: is not what was written ({beside.name} differs); make it again, or delete"
            f" {beside.name} if the change is meant"
        )


def read_settings(path: str | Path) -> dict[str, Any]:
    """Read a YAML file of names and values.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    InputError
        If the file is missing or holds something else.
    """
    path = Path(path)
    check_is_file(str(path), "YAML")
    if os.path.getsize(path) > LARGEST_TEXT:
        raise InputError(f"{path}: is too large for a file of settings")
    try:
        with origin.reading(path):
            values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except InputError:
        raise
    except RecursionError:
        raise InputError(f"{path}: cannot be read as YAML (too deep)") from None
    except (OSError, ValueError, TypeError, AttributeError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read as YAML ({one_line(error)})") from None
    if not isinstance(values, dict) or not all(isinstance(name, str) for name in values):
        raise InputError(f"{path}: holds no names and values")
    return values


def write_json(path: str | Path, values: dict[str, Any]) -> None:
    """Write a summary, indented.

    Parameters
    ----------
    path : str or Path
    values : dict
        What JSON can hold.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values, indent=2) + "\n")
