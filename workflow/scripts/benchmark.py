"""The tables of the benchmark, and time, memory and error of each tool by size."""

from pathlib import Path

import matplotlib as mpl
import pandas as pd
from marks import look
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from eofm import io
from eofm.analysis.figures import STYLE, save
from eofm.settings import Figures

PANELS = {
    "seconds": "time on one thread [s]",
    "peak_mb": "memory [MB]",
    "mean_error_px": "mean error [px]",
}


def draw(table: pd.DataFrame) -> Figure:
    """Three panels with logarithmic axes; tools that are not installed are left out."""
    with mpl.rc_context(STYLE):
        figure = Figure((7.4, 2.9), layout="constrained")
        axes = figure.subplots(1, len(PANELS))
        for axis, (column, label) in zip(axes, PANELS.items(), strict=True):
            # A run may need no more memory than importing did.
            shown = table[table[column] > 0]
            for tool, rows in shown.groupby("tool", sort=False):
                axis.plot(rows["size"], rows[column], linewidth=1, **look(tool))
            axis.set(xscale="log", yscale="log", xlabel="side of the images [px]", ylabel=label)
            axis.set_xticks(sorted(set(table["size"])), labels=sorted(set(table["size"])))
            axis.xaxis.set_minor_locator(NullLocator())
            axis.yaxis.set_major_formatter("{x:g}")
            axis.grid(which="major", linewidth=0.3, alpha=0.5)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right center", frameon=False)
    return figure


tables = {
    name: pd.concat(map(pd.read_csv, snakemake.input[name])) for name in ("estimate", "solver")
}
for name, table in tables.items():
    io.write_table(Path(snakemake.output[name]), table)
save(
    draw(tables["estimate"]),
    [Path(snakemake.output.png), Path(snakemake.output.pdf)],
    Figures(**snakemake.params.figures),
)
