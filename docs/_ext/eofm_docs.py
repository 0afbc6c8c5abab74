"""What the site takes from the code itself: the command's options and the keys of settings."""

import argparse
import hashlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

import eofm
from eofm.app import cli
from eofm.settings import Section

PAGE = """\
# The command

The pages below are written from the parser of `eofm` itself, so they say what `eofm STEP --help`
says. Lengths are in px unless another unit is named. Exit status: 0 where it worked, 1 where an
input cannot be used (one line says why), 2 where the call is wrong, and 3 where a result was
written that must not be trusted.

"""
# What argparse calls its groups, and what they are here.
TITLES = {"positional arguments": "files by position", "options": "files and options by name"}

PEERS = """\
# Other tools and their settings

Settings of the tools that figures compare with, from `workflow/scripts/peers.py`, which runs them.

"""


# Pages that may be missing.
PERHAPS = ("reliability",)

# What the sources of the library were when the examples last ran.
RECORD = "_build/code.txt"


def state(folder: Path) -> str:
    """Checksum of the sources of a folder."""
    parts = (path.read_bytes() for path in sorted(folder.rglob("*.py")))
    return hashlib.sha256(b"".join(parts)).hexdigest()


def changed_code(folder: Path, docs: Path) -> bool:
    """Whether the sources of a folder differ from those with which the site was last built."""
    record = docs / RECORD
    return not record.exists() or record.read_text() != state(folder)


def record_code(app: Sphinx, exception: Exception | None) -> None:
    """Remember the sources with which all examples ran."""
    if exception is None:
        record = Path(app.srcdir) / RECORD
        record.parent.mkdir(parents=True, exist_ok=True)
        record.write_text(state(Path(app.srcdir).parent / "eofm"))


def plain_look(gallery_conf: dict[str, Any], fname: str) -> None:
    """Set the look of all figures of the examples."""
    import matplotlib as mpl

    mpl.rcParams.update(
        {
            "figure.constrained_layout.use": True,
            "figure.dpi": 110,
            "savefig.dpi": 110,
            "font.size": 9,
            "axes.titlesize": 9,
            "image.interpolation": "nearest",
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    )


def command_page() -> str:
    """The reference of the command, as Markdown."""
    parser = cli.parser()
    steps = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    names = [(f"[`eofm {name}`](#eofm-{name})", _first(sub)) for name, sub in steps.choices.items()]
    parts = [PAGE, _table(names, ("step", "what it does"))]
    for name, sub in steps.choices.items():
        parts += [f"\n## eofm {name}\n\n", _description(sub)]
        for group in sub._action_groups:
            rows = [_row(a) for a in group._group_actions if a.dest != "help"]
            title = TITLES.get(group.title or "", group.title)
            parts += [f"\n**{title}**\n\n", _table(rows, ("", "meaning"))] if rows else []
    return "".join(parts)


def peers_page(scripts: Path) -> str:
    """What the functions that run other tools say of them, as Markdown."""
    sys.path.insert(0, str(scripts))
    import peers

    text = "\n\n".join((peers.__doc__ or "").strip().split("\n\n")[1:])
    parts = [inspect.cleandoc(tool.__doc__ or "") for tool in peers.TOOLS.values()]
    names = [part.partition(".")[0] for part in parts]
    assert len(set(names)) == len(names)
    return (
        PEERS + "\n\n".join([text, *(f"- {part}".replace("\n", "\n  ") for part in parts)]) + "\n"
    )


def _first(parser: argparse.ArgumentParser) -> str:
    return (parser.description or "").strip().splitlines()[0]


def _description(parser: argparse.ArgumentParser) -> str:
    """The help of a step: its words, and its commands as blocks of code."""
    lines = (parser.description or "").strip().splitlines()
    text, code = [], False
    for line in lines:
        command = line.startswith("  ") or line.startswith("eofm ")
        if command != code and (command or line.strip()):
            text.append("```" if code else "```sh")
            code = command
        text.append(line)
    return "\n".join([*text, "```"] if code else text) + "\n"


def _row(action: argparse.Action) -> tuple[str, str]:
    name = ", ".join(action.option_strings) or action.dest
    value = f" {action.metavar}" if action.option_strings and action.metavar else ""
    required = " (required)" if action.option_strings and action.required else ""
    return f"`{name}{value}`", f"{action.help or ''}{required}"


def _table(rows: list[tuple[str, str]], head: tuple[str, str]) -> str:
    lines = [[cell.replace("|", "\\|") for cell in row] for row in (head, ("---", "---"), *rows)]
    return "".join(f"| {a} | {b} |\n" for a, b in lines)


def describe_keys(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: Any) -> None:
    """Append a list of the keys of settings to their documentation."""
    if what == "class" and isinstance(obj, type) and issubclass(obj, Section):
        lines += list(_keys(obj))


def _keys(section: type[Section]) -> Iterator[str]:
    yield from ("", ".. list-table::", "   :header-rows: 1", "   :class: keys", "")
    yield from ("   * - key", "     - meaning, unit", "     - default")
    for name, field in section.model_fields.items():
        default = "required" if field.is_required() else f"``{field.get_default()!r}``"
        yield from (f"   * - ``{name}``", f"     - {field.description}", f"     - {default}")
    yield ""


def short_signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str, returns: str
) -> tuple[str, str] | None:
    """Settings take keys by name, whose table stands below; defaults read as they are written."""
    if what == "class" and isinstance(obj, type) and issubclass(obj, Section):
        return "(**keys)", ""
    if signature:
        # Settings as defaults show themselves in full.
        return re.sub(r"=(\w+)\((?:[^()]|\([^()]*\))*\)", r"=\1()", signature), returns
    return None


def write_pages(app: Sphinx) -> None:
    """Write what is made from code, where it has changed."""
    source = Path(app.srcdir)
    pages = {
        source / "reference/command.md": command_page(),
        source / "validation/peers.md": peers_page(source.parent / "workflow/scripts"),
    }
    for page, text in pages.items():
        if not page.exists() or page.read_text() != text:
            page.write_text(text)


def skip_missing(app: Sphinx, name: str, source: list[str]) -> None:
    """Leave pages out of a table of contents that are not there."""
    for page in PERHAPS:
        if not (Path(app.srcdir) / f"{page}.md").exists():
            source[0] = source[0].replace(f"\n../{page}\n", "\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    assert eofm.__all__  # the package that is documented is the one that is imported
    app.connect("builder-inited", write_pages, priority=100)
    app.connect("source-read", skip_missing)
    app.connect("build-finished", record_code)
    app.connect("autodoc-process-docstring", describe_keys)
    app.connect("autodoc-process-signature", short_signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
