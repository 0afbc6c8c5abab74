"""Fail where the built site has a dead link, an example that did not run, or a function without.

    python docs/check_site.py docs/_build/html

Only links within the site are followed: it has to be right without a network.
"""

import inspect
import json
import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from operator import attrgetter
from pathlib import Path
from urllib.parse import unquote, urlsplit

from numpydoc.docscrape import NumpyDocString

import eofm

DOCS = Path(__file__).parent
# Lines that an example may have.
LONGEST = 60


class Page(HTMLParser):
    """The links of a page, and the names that links may point to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.names: set[str] = {""}
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what an element refers to, and its own name."""
        given = dict(attrs)
        self.names |= {given[key] or "" for key in ("id", "name") if key in given}
        self.links += [given[key] or "" for key in ("href", "src") if key in given]


def dead_links(root: Path) -> Iterator[str]:
    """Links that lead nowhere, each with its page."""
    pages = {
        path.resolve(): Page(path)
        for path in sorted(root.rglob("*.html"))
        if "_static" not in path.parts
    }
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            name = unquote(parts.fragment)
            if not target.exists():
                yield f"{path.relative_to(root.resolve())}: {link} does not exist"
            elif target in pages and name not in pages[target].names:
                yield f"{path.relative_to(root.resolve())}: {link} has no such place"


def missing_examples(root: Path) -> Iterator[str]:
    """Examples that are too long, were not run as they are, or have no picture."""
    for script in sorted((DOCS / "examples").glob("*.py")):
        text = script.read_text()
        if text.count("\n") > LONGEST:
            yield f"{script.name}: has {text.count(chr(10))} lines, of {LONGEST}"
        page = root / "gallery" / f"{script.stem}.html"
        if not page.exists() or (DOCS / "gallery" / script.name).read_text() != text:
            yield f"{script.name}: was not run"
        elif not re.search("sphx-glr-(single|multi)-img", page.read_text()):
            yield f"{script.name}: has no picture"


def undocumented(root: Path) -> Iterator[str]:
    """Public names without a page or words, and functions whose parameters or examples are missing.

    Functions that read and write files are public too; few examples need more than two of them.
    """
    used = json.loads((DOCS / "gallery/backreferences/backreferences_all.json").read_text())
    files = (f"io.{name}" for name in sorted(vars(eofm.io)) if name.startswith(("read_", "write_")))
    for name in [*eofm.__all__, *files]:
        thing = attrgetter(name)(eofm)
        if inspect.ismodule(thing):
            continue
        if not (root / f"reference/generated/eofm.{name}.html").exists():
            yield f"eofm.{name}: has no page; add it to docs/reference/api.md"
        if not thing.__doc__:
            yield f"eofm.{name}: has no docstring"
        if not inspect.isfunction(thing):
            continue
        said = NumpyDocString(inspect.getdoc(thing) or "")
        listed = {part for p in said["Parameters"] for part in p.name.replace("*", "").split(", ")}
        for parameter in inspect.signature(thing).parameters.keys() - listed:
            yield f"eofm.{name}: its docstring says nothing of {parameter}"
        if name in eofm.__all__ and not used.get(f"eofm.{name}"):
            yield f"eofm.{name}: no example in docs/examples uses it"


def main() -> None:
    """Say what is wrong, line by line."""
    root = Path(sys.argv[1])
    wrong = [*dead_links(root), *missing_examples(root), *undocumented(root)]
    sys.exit("\n".join(wrong) if wrong else 0)


if __name__ == "__main__":
    main()
