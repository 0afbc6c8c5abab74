"""Relative errors of the other tools on one phantom; no value where one is not installed."""

from contextlib import redirect_stdout
from pathlib import Path

import pandas as pd
import peers

from eofm import io
from eofm.analysis.metrics import relative_errors
from eofm.imaging.intensity import normalise

truth = io.read_field(Path(snakemake.input.truth))
images = io.read_pair(Path(snakemake.input.reference), Path(snakemake.input.deformed))
row = {"phantom": int(snakemake.wildcards.number)}
with Path(snakemake.log[0]).open("w") as log, redirect_stdout(log):
    for tool in snakemake.params.tools:
        u = peers.estimate(tool, *normalise(*images))
        row[tool] = None if u is None else relative_errors(u, truth)["e_rel"]
io.write_table(Path(snakemake.output[0]), pd.DataFrame([row]))
