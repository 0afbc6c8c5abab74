"""Checked settings, and what every rule needs to state its command and its inputs."""

import io
import json
import os
import re
import shlex
import sys
from difflib import get_close_matches
from pathlib import Path

import pandas as pd

import eofm
import eofm.app.config
from eofm.app.cli import ANALYSIS
from eofm.errors import InputError
from eofm.settings import WARPING

# Jobs run with this interpreter's commands, whatever the PATH of the caller.
# A step that ends with 3 has written a result that it says not to trust: the log says why, and
# what follows shows it.
shell.prefix(
    f"set -euo pipefail; export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH; "
)

try:
    settings = eofm.app.config.Config.parse(config, "configuration")
except InputError as error:
    sys.exit(f"{error}; every key is explained in config/README.md")

TESTS = list(settings.tests)
# Past the paper: the preset, and the preset with the identified sample's background.
OURS = ["5b", "6"]
ROWS = ["background", *TESTS, *OURS]
# Past the paper, motions are larger than the speckle, and I2 is warped by u.
WARPED = settings.estimation.changed(zero_edges=(), **WARPING)
# Test 5's parameters for images of which nothing else is known: standard optical flow.
IMAGES_ONLY = WARPED.changed(beta=0.0)

SCRIPTS = Path(os.path.relpath(Path(workflow.basedir) / "workflow/scripts"))
sys.path.insert(0, str(SCRIPTS))
from imports import Sources

SOURCES = Sources(Path(os.path.relpath(Path(eofm.__file__).parent)), SCRIPTS)


def code(name):
    """Files behind a script NAME.py or a step of the command: editing one reruns a rule."""
    of = SOURCES.of_script if name.endswith(".py") else SOURCES.of_step
    return sorted(map(str, of(name)))


def options(*sections):
    """Command-line options that state all values of some sections."""
    words = []
    for section in sections:
        for name, value in section.model_dump(mode="json").items():
            words.append(f"--{name.replace('_', '-')}")
            if value is None:
                value = "none"
            words += [
                item if isinstance(item, str) else json.dumps(item)
                for item in (value if isinstance(value, list) else [value])
            ]
    return shlex.join(words)


def read_samples(path):
    """Rows of the table of samples by name, as texts, without empty cells."""
    known = [
        "sample",
        "settings",
        *(name for section in ANALYSIS for name in section.model_fields),
    ]
    try:
        # Only whole lines are comments: FILE#3 is page 3 of a file.
        lines = [
            line for line in Path(path).read_text().splitlines() if line[:1] != "#"
        ]
        for number, line in enumerate(lines):
            if line.count("\t") > lines[0].count("\t"):
                sys.exit(
                    f"{path}: row {number} has more cells than the table has columns"
                )
        text = io.StringIO("\n".join(lines))
        table = pd.read_csv(text, sep="\t", dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        sys.exit(f"{path}: cannot be read as a table ({error}); see config/README.md")
    for column in table:
        if column not in known:
            close = get_close_matches(column, known, 1)
            sys.exit(
                f"{path}: unknown column {column}; "
                + (f"did you mean {close[0]}?" if close else "see config/README.md")
            )
    if "sample" not in table:
        sys.exit(f"{path}: lacks the column sample")
    for name in table["sample"]:
        if not re.fullmatch(r"[\w-][\w.-]*", name):
            sys.exit(
                f"{path}: sample '{name}': use letters, digits, dots, - and _ in names"
            )
        if (table["sample"] == name).sum() > 1:
            sys.exit(f"{path}: sample {name} stands in it twice; rename one")
    rows = table.to_dict("records")
    return {
        row.pop("sample"): {k: v for k, v in row.items() if v.strip()} for row in rows
    }


def sample_options(row):
    """Command-line options of a row of the table of samples."""
    words = []
    for name, text in row.items():
        option = f"--{name.replace('_', '-')}"
        many = any(
            name in section.model_fields and section.takes_many(name)
            for section in ANALYSIS
        )
        words += [option, *text.split()] if many else [f"{option}={text}"]
    return shlex.join(words)


def sample_files(row):
    """Files that a row names, but those that are not there: the step says so in one line."""
    texts = [
        row.get(k, "") for k in ("reference", "deformed", "frames", "mask", "settings")
    ]
    texts += [row.get("background", "")]
    texts += [
        row.get(edge, "").split()[-1:] for edge in ("top", "bottom", "left", "right")
    ]
    names = [t[0] if isinstance(t, list) and t else t for t in texts]
    files = [str(name).partition("#")[0] for name in names if name]
    return [f for f in files if f.startswith("results/") or Path(f).is_file()]


def test_figure(name, test):
    """A figure of a test, shown in the report."""
    return report(
        f"results/figures/{name}.png",
        caption="../report/figure_test.rst",
        category="Tests",
        labels={"figure": name, "test": test},
    )


def sample_figure(name):
    """A figure of a sample, shown in the report."""
    return report(
        f"results/samples/{{sample}}/{name}.png",
        caption="../report/sample.rst",
        category="Samples",
        subcategory="{sample}",
        labels={"result": name},
    )
