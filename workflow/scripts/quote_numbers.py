"""Put the measured numbers of ``docs/figures`` into the texts that quote them.

    python workflow/scripts/quote_numbers.py          # writes README.md, config/README.md and docs
    python workflow/scripts/quote_numbers.py --check  # fails where text and numbers disagree

In a text, what stands between ``<!--paper: table.5.e_rel .1f-->`` and ``<!--/-->`` is the value
``table.5.e_rel`` of ``docs/figures/paper.json`` in the format ``.1f``, and what stands between
``<!--rows: paper-->`` and ``<!--/-->`` a table, which a function here makes of that file.
"""

import argparse
import json
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
MARK = re.compile(r"(<!--([a-z]\w*): ([^>\s]+)(?: ([^>\s]+))?-->)(.*?)(<!--/-->)", re.DOTALL)

# Rows of Table 1: name, background, beta, multi-scale.
TESTS = {
    "background": ("background alone", "", "", ""),
    "1": ("1", "no", "0.5", "yes"),
    "2": ("2", "yes", "0", "no"),
    "3": ("3", "yes", "0", "yes"),
    "4": ("4", "yes", "0.5", "no"),
    "5": ("5", "yes", "0.5", "yes"),
    "5b": ("**5b** (ours)", "yes", "", "yes"),
    "6": ("**6** (ours)", "identified", "", "yes"),
}
METHODS = {
    "preset_free": "preset, images only",
    "preset": "preset",
    "test6": "test 6",
    "test5": "paper's test 5",
    "elastix": "elastix",
    "demons": "demons",
    "dis": "DIS",
}
TOOLS = {
    "eofm preset": "preset",
    "eofm": "test 5",
    "dis": "DIS",
    "deepflow": "DeepFlow",
    "ilk": "ILK",
    "tvl1": "TV-L1",
    "elastix": "elastix",
    "demons": "demons",
    "pyxel": "pyxel",
}


@cache
def measured(name: str) -> dict[str, Any]:
    """Content of a file of numbers."""
    return json.loads((ROOT / f"docs/figures/{name}.json").read_text())


def value(name: str, key: str) -> Any:
    """A number of a file, or its date, command or machine, by keys with dots between."""
    found = measured(name)
    if key not in found:
        found = found["values"]
        for part in key.split("."):
            found = found[part]
        return found
    return found[key]


def table1() -> list[list[str]]:
    """Table 1 beside the paper's, with the largest errors of both."""
    heads = ["test", "background", "β", "multi-scale", "e_rel(u)", "e_rel(u1)", "e_rel(u2)"]
    heads += ["the paper's", "largest errors, px", "the paper's"]
    errors = ["e_rel", "e_rel_u1", "e_rel_u2"]
    lines = [heads]
    for test, words in TESTS.items():
        row = value("paper", f"table.{test}") | value("paper", f"largest.{test}")
        ours = [f"{row[name]:.1f}" for name in errors]
        paper = [f"{row[f'paper_{name}']:.1f}" for name in errors if f"paper_{name}" in row]
        largest = [f"{row[f'max_error_u{i}']:.2f}" for i in (1, 2)]
        quoted = [f"{row[name]:g}" for name in row if name.startswith("paper_max")]
        lines.append([*words, *ours, *map(" / ".join, (paper, largest, quoted))])
    return lines


def ensemble() -> list[list[str]]:
    """Median errors of the methods and tools."""
    median = value("ensemble", "median")
    return [[*METHODS.values()], [f"{median[name]:.1f}" for name in METHODS]]


def benchmark() -> list[list[str]]:
    """Error, time and memory of all tools."""
    tools, px = value("benchmark", "tools"), value("benchmark", "size.px")
    columns = [tools[name] for name in TOOLS]
    return [
        [f"{px} x {px} px", *TOOLS.values()],
        ["mean error, px", *(f"{tool['mean_error_px']:.3f}" for tool in columns)],
        ["time on one thread, s", *(f"{tool['seconds']:.2g}" for tool in columns)],
        ["memory, MB", *(f"{tool['peak_mb']:.0f}" for tool in columns)],
    ]


def robustness() -> list[list[str]]:
    """Median errors of the preset and of the best other tool, by condition."""
    rows = value("robustness", "conditions")
    lines = [["condition", "preset, px", "best other tool, px", "preset / best, median", "worst"]]
    for name, row in rows.items():
        numbers = [row.get(key) for key in ("preset", "best", "ratio", "worst_ratio")]
        cells = ["" if number is None else f"{number:.2g}" for number in numbers]
        lines.append([name.replace("_", " "), *cells])
    return lines


TABLES = {
    "paper": table1,
    "ensemble": ensemble,
    "benchmark": benchmark,
    "robustness": robustness,
}


def filled(text: str) -> str:
    """A text with its numbers and tables as the files have them."""

    def fill(match: re.Match[str]) -> str:
        start, name, key, form, _, end = match.groups()
        if name == "rows":
            head, *body = TABLES[key]()
            lines = [head, ["---"] * len(head), *body]
            rows = [f"| {' | '.join(line)} |" for line in lines]
            return "\n".join([start, *rows, end])
        return start + format(value(name, key), form or "") + end

    return MARK.sub(fill, text)


def texts() -> list[Path]:
    """All texts that may quote numbers."""
    return [*ROOT.glob("*.md"), *ROOT.glob("config/*.md"), *ROOT.glob("docs/**/*.md")]


def main() -> None:
    """Write the texts, or say which are wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="change nothing, fail instead")
    check = parser.parse_args().check
    wrong = {path: new for path in texts() if (new := filled(path.read_text())) != path.read_text()}
    for path, text in wrong.items():
        word = "disagrees with" if check else "written from"
        print(f"{path.relative_to(ROOT)}: {word} docs/figures")
        if not check:
            path.write_text(text)
    sys.exit("run make numbers" if check and wrong else 0)


if __name__ == "__main__":
    main()
