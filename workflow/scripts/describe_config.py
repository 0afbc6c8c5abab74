"""Write what follows from the typed settings: the JSON schema and the tables of keys.

    python workflow/scripts/describe_config.py

A test fails when the two files and the models drift apart.
"""

import json
import types
from pathlib import Path
from typing import get_args

from eofm.app.config import Config
from eofm.settings import Pair, Section

FOLDER = Path(__file__).parents[2] / "config"
MARK = "<!-- The tables below are written by workflow/scripts/describe_config.py. -->"


def schema() -> str:
    """JSON schema of the configuration, for editors and validators."""
    return json.dumps(Config.model_json_schema(), indent=2) + "\n"


def readme(text: str) -> str:
    """The README with its tables, below the mark, made anew."""
    head, _, _ = text.partition(MARK)
    return head + MARK + "\n" + "\n".join([*_tables(Config, ""), *_tables(Pair, "pair.")])


def _tables(model: type[Section], path: str) -> list[str]:
    lines, inner = [], []
    for name, field in model.model_fields.items():
        section = _section(field.annotation)
        if section:
            entry = (
                ""
                if field.annotation is section
                else ("[]" if "tuple" in str(field.annotation) else ".NAME")
            )
            inner += _tables(section, f"{path}{name}{entry}.")
        if field.description:
            default = (
                json.loads(json.dumps(field.get_default(), default=str))
                if not field.is_required()
                else None
            )
            shown = "required" if field.is_required() else f"`{json.dumps(default)}`"
            lines.append(f"| `{name}` | {field.description} | {shown} |")
    if lines:
        head = [f"\n### `{path.rstrip('.')}`\n", _summary(model), ""]
        lines = [*head, "| key | meaning, unit | default |", "|---|---|---|", *lines]
    return lines + inner + ([""] if not path else [])


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
