"""Run ``snakemake --lint`` and fail on whatever it finds, but for one thing.

It wants a conda environment or a container in every rule. Here one environment, made by
``make`` from constraints.txt, serves the rules and Snakemake itself.
"""

import re
import subprocess
import sys

ACCEPTED = "Specify a conda environment or container for each rule."

result = subprocess.run(
    [sys.executable, "-m", "snakemake", "--lint"], capture_output=True, text=True
)
titles = set(re.findall(r"^ +\* (.+):$", result.stderr, flags=re.MULTILINE))
if titles - {ACCEPTED} or (result.returncode and not titles):
    sys.exit(result.stdout + result.stderr)
