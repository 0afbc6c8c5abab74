"""Write what follows from the typed settings: the JSON schema and the tables of keys.

    python workflow/scripts/describe_config.py

A test fails when the two files and the models drift apart.
"""

import json
import types
from pathlib import Path
from typing import Any, get_args

from eofm.app.config import Config, load
from eofm.settings import Pair, Section, Tiling

FOLDER = Path(__file__).parents[2] / "config"
MARK = "<!-- The tables below are written by workflow/scripts/describe_config.py. -->"


def schema() -> str:
    """JSON schema of the configuration, for editors and validators."""
    return json.dumps(Config.model_json_schema(), indent=2) + "\n"


def readme(text: str) -> str:
    """The README with its tables, below the mark, made anew."""
    head, _, _ = text.partition(MARK)
    experiment = load(FOLDER / "config.yaml").model_dump(mode="json")
    lines = [*_tables(Config, "", experiment), *_tables(Pair, "pair.", None)]
    lines += _tables(Tiling, "tiling.", None)
    return head + MARK + "\n" + "\n".join(lines)


def _tables(model: type[Section], path: str, values: Any) -> list[str]:
    """The table of a model and those of the models inside it.

    ``values`` are the experiment's: of one section, of a list or of a dictionary of them.
    """
    lines, inner = [], []
    for name, field in model.model_fields.items():
        section = _section(field.annotation)
        chosen = _each(values, name)
        if section:
            plain = field.annotation is section
            entry = "" if plain else "[]" if "tuple" in str(field.annotation) else ".NAME"
            inner += _tables(section, f"{path}{name}{entry}.", chosen)
        if field.description:
            default = "required" if field.is_required() else _shown(field.get_default())
            last = "" if values is None else f" {_shown(chosen)} |"
            lines.append(f"| `{name}` | {field.description} | {default} |{last}")
    if lines:
        head = [f"\n### `{path.rstrip('.')}`\n" if path else "\n### At the top\n"]
        columns = ["key", "meaning, unit", "default"] + ["the experiment"] * (values is not None)
        head += [_summary(model), "", f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
        lines = [*head, *lines]
    return lines + inner + ([""] if not path else [])


def _each(values: Any, name: str) -> Any:
    """The value of a key; of several sections, those of each."""
    if values is None or name in values:
        return values and values[name]
    if isinstance(values, list):
        return [value[name] for value in values]
    return {key: value[name] for key, value in values.items()}


def _shown(value: Any) -> str:
    return f"`{json.dumps(value, default=str)}`"


def _summary(model: type[Section]) -> str:
    return (model.__doc__ or "").strip().splitlines()[0]


def _section(annotation: object) -> type[Section] | None:
    """The model inside an annotation, if there is one."""
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation if issubclass(annotation, Section) else None
    return next(filter(None, map(_section, get_args(annotation))), None)


if __name__ == "__main__":
    (FOLDER / "config.schema.json").write_text(schema())
    path = FOLDER / "README.md"
    path.write_text(readme(path.read_text()))
