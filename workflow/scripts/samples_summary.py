"""One table of all samples, as CSV and as pages."""

import json
from pathlib import Path

from samples_page import write

states = [json.loads(Path(file).read_text()) for file in snakemake.input.states]
write(states, Path(snakemake.output.csv).parent)
