"""Figures 3 to 7 of the paper, and other tests drawn in the same way.

All tests share the scales: of the true field, and of the largest error of the paper's tests.
"""

from pathlib import Path

import numpy as np

from eofm import io
from eofm.analysis.figures import field, field_and_error, image_pair, save
from eofm.settings import Figures

settings = Figures(**snakemake.params.figures)
files = {name: Path(path) for name, path in snakemake.input.items() if isinstance(path, str)}
truth = io.read_field(files["truth"])
errors = [np.abs(io.read_field(Path(path)) - truth).max() for path in snakemake.input.tests]
for name, path in snakemake.output.items():
    if name == "pdf":
        continue
    if name == "figure3":
        figure = image_pair(*io.read_pair(files["reference"], files["deformed"]), settings)
    elif name == "figure4":
        figure = field(truth, settings)
    else:
        deviation = files.get(f"{name}_deviation")
        # In px, with the digits of the tables.
        figure = field_and_error(
            io.read_field(files[name]),
            truth,
            round(float(max(errors)), 6),
            settings,
            deviation and io.read_field(deviation),
        )
    save(figure, [Path(path), Path(path).with_suffix(".pdf")], settings)
