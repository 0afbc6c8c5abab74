"""Figures 5 to 7: estimated field and absolute error of one test, and its error bars.

All tests share the scales: of the true field, and of the largest error in Table 1.
"""

from pathlib import Path

import pandas as pd

from eofm import io
from eofm.analysis.figures import field_and_error, save
from eofm.settings import Figures

settings = Figures(**snakemake.params.figures)
table = pd.read_csv(snakemake.input.table)
largest = table.loc[table.test != "background", ["max_error_u1", "max_error_u2"]].max(axis=None)
deviation = snakemake.input.get("deviation")
figure = field_and_error(
    io.read_field(Path(snakemake.input.estimate)),
    io.read_field(Path(snakemake.input.truth)),
    largest,
    settings,
    io.read_field(Path(deviation)) if deviation else None,
)
save(figure, [Path(snakemake.output.png), Path(snakemake.output.pdf)], settings)
