"""Errors of the estimates of a volume, and figures of them in three orthogonal sections."""

from pathlib import Path

import numpy as np
import pandas as pd

from eofm import io
from eofm.analysis.figures import compare_errors, save
from eofm.analysis.metrics import relative_errors
from eofm.settings import Figures

settings = Figures(**snakemake.params.figures)
truth, background = (io.read_field(Path(snakemake.input[name])) for name in ("truth", "background"))
folder = Path(snakemake.output.errors).parent
rows = []
for images in ("bubbles", "speckle"):
    fields = {"background": background}
    rows.append({"images": images, "method": "background"} | relative_errors(background, truth))
    for method in snakemake.params.methods:
        u, deviation = (
            io.read_field(folder / images / method / f"{name}.tif")
            for name in ("displacement", "deviation")
        )
        fields[method] = u
        coverage = {"coverage": float(np.mean(np.abs(u - truth) < deviation))}
        rows.append({"images": images, "method": method} | relative_errors(u, truth) | coverage)
    png = Path(snakemake.output[images])
    save(compare_errors(fields, truth, settings), [png, png.with_suffix(".pdf")], settings)
io.write_table(Path(snakemake.output.errors), pd.DataFrame(rows))
