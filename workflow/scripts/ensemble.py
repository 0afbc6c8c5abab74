"""Errors of all methods and tools on the random phantoms: the table and its figure."""

from pathlib import Path

import matplotlib as mpl
import pandas as pd
from marks import look
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from eofm import io
from eofm.analysis.figures import STYLE, save
from eofm.settings import Figures

METHODS = ["background", "test5", "preset_free", "preset", "test6", *snakemake.params.tools]
KIND = ["phantom", "half", "renderer", "noise", "brightness", "inclusions", "cut"]
IDENTIFIED = ["verdict", "dice", "modulus_error", "coverage", "coverage_modulus"]
COLUMNS = [*KIND, *METHODS, *IDENTIFIED]


def draw(table: pd.DataFrame) -> Figure:
    """Relative error per phantom for each method, with a logarithmic axis."""
    with mpl.rc_context(STYLE):
        figure = Figure((6.2, 3.4), layout="constrained")
        axis = figure.subplots()
        for name in METHODS:
            if table[name].notna().any():
                axis.plot(table["phantom"], table[name], linestyle=":", linewidth=0.5, **look(name))
        axis.set(yscale="log", xlabel="phantom", ylabel="relative error of u [%]")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.grid(axis="y", which="both", linewidth=0.3, alpha=0.5)
        figure.legend(loc="outside right upper", frameon=False)
    return figure


ours, others = (pd.concat(map(pd.read_csv, snakemake.input[name])) for name in ("ours", "others"))
table = ours.merge(others, on="phantom")[COLUMNS]
io.write_table(Path(snakemake.output.table), table)
medians = table.groupby(["half", "cut"]).median(numeric_only=True)
Path(snakemake.log[0]).write_text(f"medians\n{medians.drop(columns='phantom').T.to_string()}\n")
save(
    draw(table),
    [Path(snakemake.output.png), Path(snakemake.output.pdf)],
    Figures(**snakemake.params.figures),
)
