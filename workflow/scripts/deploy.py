"""Where the commands of rules come from: this interpreter, or an environment of their own."""

import shlex
import sys
from collections.abc import Collection
from enum import Enum
from pathlib import Path


def prefix(checkout: Path, deployed: Collection[Enum]) -> str:
    """What comes before the shell command of every rule.

    Jobs run with the commands of this interpreter, whatever the PATH of the caller. Those in an
    environment or container of their own take its interpreter, and the package of the checkout.

    Parameters
    ----------
    checkout : Path
        Folder of the Snakefile.
    deployed : collection of DeploymentMethod
        What --software-deployment-method says.
    """
    if {"CONDA", "APPTAINER"} & {method.name for method in deployed}:
        path = f"export PYTHONPATH={shlex.quote(str(checkout))}${{PYTHONPATH:+:$PYTHONPATH}}"
        return f'set -euo pipefail; {path}; eofm() {{ python -m eofm.app.cli "$@"; }}; '
    path = f"export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH"
    return f"set -euo pipefail; {path}; "
