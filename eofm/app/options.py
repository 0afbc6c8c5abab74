"""Command lines made from the signatures of steps, and arguments of steps from command lines.

A parameter of a step is a file, annotated by :func:`reads` or :func:`writes`, or a section of
settings, each of whose keys becomes an option. Files without a default are required: those
before the sections by position, the others by name.
"""

import argparse
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from eofm import io
from eofm.errors import InputError
from eofm.settings import PAPER, Estimation, Section

Step = Callable[..., Any]

# Values for which help and tables say none.
NONE = (None, ())


@dataclass(frozen=True)
class File:
    """What a file of a step is for, in words that end in its (FORMAT), and who writes it."""

    help: str
    written: bool

    @property
    def format(self) -> str | None:
        """The format that stands in brackets at the end of the help."""
        return self.help.rpartition("(")[2].rstrip(")") if self.help.endswith(")") else None


def reads(help: str) -> File:
    """Annotation of a file that a step reads."""
    return File(help, written=False)


def writes(help: str) -> File:
    """Annotation of a file, or of the folder, that a step writes."""
    return File(help, written=True)


def files_of(step: Step) -> dict[str, File]:
    """Files of a step by the names of its parameters."""
    parameters = inspect.signature(step).parameters.items()
    said = {name: get_args(p.annotation)[1:] for name, p in parameters}
    return {name: notes[0] for name, notes in said.items() if notes}


def sections_of(step: Step) -> dict[str, type[Section]]:
    """Sections of settings of a step by the names of its parameters."""
    parameters = inspect.signature(step).parameters.items()
    return {name: p.annotation for name, p in parameters if isinstance(p.annotation, type)}


@dataclass(frozen=True)
class Files:
    """Files that were named for a step."""

    read: list[Path]
    written: dict[Path, str | None]

    @classmethod
    def of(cls, step: Step, given: Mapping[str, Any]) -> "Files":
        """Return those among the arguments of a step."""
        named = [(file, given[name]) for name, file in files_of(step).items() if given[name]]
        read = [path for file, path in named if not file.written]
        written = [(path, file.format) for file, path in named if file.written]
        for path, _ in written:
            if [p.resolve() for p, _ in written].count(path.resolve()) > 1:
                raise InputError(f"{path}: is named for two results; give each its own file")
        return cls(read, dict(written))

    def check(self) -> None:
        """Refuse, before any work, what could not be written or would overwrite what is read.

        Raises
        ------
        InputError
            If it cannot be written, or is a file that is read.
        """
        read = {path.resolve() for path in self.read}
        for path, format in self.written.items():
            if path.resolve() in read:
                raise InputError(f"{path}: is read; name another file to write")
            if format is not None:
                io.check_place(path, format)


class StepParser(argparse.ArgumentParser):
    """The parser of a step, which says what a misspelt option may have been."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuse unknown options first: what else is wrong may come of them."""
        known = [option for option in self._option_string_actions if option.startswith("--")]
        for word in args or ():
            name = word.partition("=")[0]
            if name == "--":  # only files follow
                break
            # Several words in one are a value; options may be shortened.
            if not name.startswith("--") or " " in name or any(o.startswith(name) for o in known):
                continue
            close = get_close_matches(name, known, 1)
            hint = f"did you mean {close[0]}?" if close else "--help names those that there are"
            self.error(f"unknown option {name}; {hint}")
        return super().parse_known_args(args, namespace)


def add_files(parser: argparse.ArgumentParser, step: Step) -> None:
    """Add the files of a step to its parser."""
    parameters = inspect.signature(step).parameters
    for name, file in files_of(step).items():
        parameter = parameters[name]
        if parameter.kind is parameter.KEYWORD_ONLY:
            option, required = f"--{name.replace('_', '-')}", parameter.default is parameter.empty
            parser.add_argument(
                option, type=Path, metavar="FILE", required=required, help=file.help
            )
        else:
            parser.add_argument(name, type=Path, help=file.help)


def add_options(parser: argparse.ArgumentParser, step: Step) -> None:
    """Add an option for every key of the sections of a step."""
    for section in sections_of(step).values():
        group = parser.add_argument_group(section.__name__.lower())
        for name, field in section.model_fields.items():
            default = field.get_default()
            shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
            note = f"default: {'none' if shown in ('', None) else shown}"
            if field.is_required():
                note = "required"
            elif section is Estimation and name in PAPER:
                note += f"; paper: {PAPER[name]}"
            group.add_argument(
                f"--{name.replace('_', '-')}",
                metavar=_value(field.annotation),
                nargs="*" if section.takes_many(name) else None,
                type=parse_optional if default in NONE else parse_value,
                default=argparse.SUPPRESS,
                help=f"{field.description} ({note})",
            )


def _value(annotation: Any) -> str:
    """What help writes for the value of an option: its choices, where there are few."""
    if get_origin(annotation) is tuple:
        annotation = get_args(annotation)[0]
    if annotation is bool:
        return "true|false"
    return "|".join(get_args(annotation)) if get_origin(annotation) is Literal else "VALUE"


def parse_value(text: str) -> Any:
    """A number, object or truth value as in JSON, or else the text itself."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):  # of too many digits, or too many brackets
        return text


def parse_optional(text: str) -> Any:
    """The same where there may be no value."""
    return None if text == "none" else parse_value(text)


def arguments_of(step: Step, args: argparse.Namespace) -> dict[str, Any]:
    """Arguments of a step: its files, and its sections checked.

    Where a step has a file of ``settings``, they come from there too; options win.

    Raises
    ------
    InputError
        If a value is wrong, or a key of the file is unknown.
    """
    files, sections = files_of(step), sections_of(step)
    arguments = {name: getattr(args, name) for name in files}
    source, given = arguments.get("settings"), {}
    if source is not None:
        given = io.read_settings(source)
        _check_keys(given, sections, source)
    for name, section in sections.items():
        values = {key: given[key] for key in section.model_fields if key in given}
        where = source or section.__name__.lower()
        arguments[name] = section.parse(values | _given(section, args), str(where))
    return arguments


def _check_keys(given: dict[str, Any], sections: dict[str, type[Section]], source: Path) -> None:
    known = sorted({key for section in sections.values() for key in section.model_fields})
    for key in given.keys() - known:
        close = get_close_matches(key, known, 1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise InputError(f"{source}: unknown key {key}{hint}")


def _given(section: type[Section], args: argparse.Namespace) -> dict[str, Any]:
    """Values of the options of a section that were named."""
    values = {}
    for name, field in section.model_fields.items():
        if hasattr(args, name):
            value, default = getattr(args, name), field.get_default()
            if section.takes_many(name):
                value = [item for one in value for item in _split(one)]
            values[name] = default if value == [None] and default in NONE else value
    return values


def _split(value: Any) -> list[Any]:
    """The values in a text that holds several, such as ``'0 0 40 40'``."""
    return [parse_value(word) for word in value.split()] if isinstance(value, str) else [value]
