"""What texts quote of the studies: the numbers that each has written, by its name."""

import json
from pathlib import Path

from record import record

values = {path.stem: json.loads(path.read_text()) for path in map(Path, snakemake.input.studies)}
record(Path(snakemake.output[0]), snakemake.params.command, values)
