"""Checked settings, and what every rule needs to state its command and its inputs."""

import ast
import json
import os
import shlex
import sys
from pathlib import Path

import eofm.config
from eofm.errors import InputError

# Jobs run with this interpreter's commands, whatever the PATH of the caller.
shell.prefix(
    f"set -euo pipefail; export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH; "
)

try:
    settings = eofm.config.Config.parse(config, "configuration")
except InputError as error:
    sys.exit(f"{error}; every key is explained in config/README.md")

TESTS = list(settings.tests)
FIGURES = ["figure3", "figure4", "figure5", "figure6", "figure7", "test2", "test4"]

PACKAGE = Path(os.path.relpath(Path(eofm.config.__file__).parent))


def code(*modules):
    """Files of modules of the package and of all that they import: editing one reruns a rule."""
    found, queue = set(), ["cli", *modules]
    while queue:
        path = PACKAGE / f"{queue.pop()}.py"
        if path in found:
            continue
        found.add(path)
        queue += [
            node.module.removeprefix("eofm.")
            for node in ast.parse(path.read_text()).body
            if isinstance(node, ast.ImportFrom)
            and (node.module or "").startswith("eofm.")
        ]
    return sorted(map(str, found))


def options(*sections):
    """Command-line options that state all values of some sections."""
    words = []
    for section in sections:
        for name, value in section.model_dump(mode="json").items():
            if value is not None:
                words.append(f"--{name.replace('_', '-')}")
                words += [
                    item if isinstance(item, str) else json.dumps(item)
                    for item in (value if isinstance(value, list) else [value])
                ]
    return shlex.join(words)
