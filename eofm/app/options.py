"""Command-line options made from the typed settings, and settings made from options."""

import argparse
import json
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, TypeVar

from eofm.errors import InputError
from eofm.settings import PAPER, Estimation, Section

S = TypeVar("S", bound=Section)

# Values for which help and tables say none.
NONE = (None, ())


def add_options(group: argparse._ArgumentGroup, section: type[Section]) -> None:
    """Add an option for every key of a section."""
    for name, field in section.model_fields.items():
        default = field.get_default()
        shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
        known = f"default: {'none' if shown in ('', None) else shown}"
        group.add_argument(
            f"--{name.replace('_', '-')}",
            metavar="VALUE",
            nargs="*" if section.takes_many(name) else None,
            type=parse_optional if default in NONE else parse_value,
            default=argparse.SUPPRESS,
            help=f"{field.description} ({'required' if field.is_required() else known}"
            + (f"; paper: {PAPER[name]}" if section is Estimation and name in PAPER else "")
            + ")",
        )


def parse_value(text: str) -> Any:
    """A number, object or truth value as in JSON, or else the text itself."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def parse_optional(text: str) -> Any:
    """The same where there may be no value."""
    return None if text == "none" else parse_value(text)


def settings_of(section: type[S], args: argparse.Namespace) -> S:
    """Checked settings of a section from the options given."""
    return section.parse(_given([section], args), section.__name__.lower())


def sections_of(
    sections: list[type[Section]], given: dict[str, Any], args: argparse.Namespace
) -> list[Any]:
    """Settings whose names do not clash, from a file and from options; options win."""
    known = {name for section in sections for name in section.model_fields}
    given = given | _given(sections, args)
    for name in given.keys() - known:
        close = get_close_matches(name, sorted(known), 1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise InputError(f"{args.settings}: unknown key {name}{hint}")
    return [
        section.parse(
            {k: v for k, v in given.items() if k in section.model_fields}, args.folder.name
        )
        for section in sections
    ]


def _given(sections: Sequence[type[Section]], args: argparse.Namespace) -> dict[str, Any]:
    """Values of the options that belong to some sections."""
    given = {}
    for section in sections:
        for name, field in section.model_fields.items():
            if hasattr(args, name):
                value, default = getattr(args, name), field.get_default()
                given[name] = default if value == [None] and default in NONE else value
    return given
