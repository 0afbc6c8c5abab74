"""Time, memory and error of one tool on one pair of images, which is all that it is given."""

from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pandas as pd
import peers
from measure import measure, peak

import eofm
from eofm import io
from eofm.imaging.intensity import normalise

# Side of the part of the images on which everything is imported and compiled, px.
SMALL = 64

tool, size = snakemake.wildcards.tool, int(snakemake.wildcards.size)


def run(I1, I2):
    """Displacement by the tool; None where it is not installed."""
    if tool in peers.TOOLS:
        return peers.estimate(tool, I1, I2)
    settings = eofm.Estimation(**snakemake.params[tool])
    return eofm.estimate_displacement(I1, I2, settings).u


truth = io.read_field(Path(snakemake.input.truth))
I1, I2 = normalise(*io.read_pair(Path(snakemake.input.reference), Path(snakemake.input.deformed)))
row = {"tool": tool.replace("_", " "), "size": size}
with Path(snakemake.log[0]).open("w") as log, redirect_stdout(log):
    if run(I1[:SMALL, :SMALL], I2[:SMALL, :SMALL]) is not None:
        u, cost = measure(lambda: run(I1, I2), peak())
        row |= cost | {"mean_error_px": float(np.hypot(*(u - truth)).mean())}
columns = ["tool", "size", "seconds", "peak_mb", "mean_error_px"]
io.write_table(Path(snakemake.output[0]), pd.DataFrame([row], columns=columns))
