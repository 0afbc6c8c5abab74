"""The table, the figure and the numbers of a study, from the rows of its parts."""

from collections.abc import Callable
from itertools import pairwise, permutations
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from paper import TABLE
from search_phantom import BOUNDS, parameters

from eofm import io
from eofm.analysis.figures import STYLE, save
from eofm.app.config import Config

Numbers = dict[str, Any]
Study = tuple[pd.DataFrame, Figure, Numbers]

CELLS = ["e_rel", "e_rel_u1", "e_rel_u2"]
METHODS = {"5": "test 5", "5b": "preset", "6": "test 6"}
# Best phantoms of each search that are compared.
BEST = 10


def readings(rows: pd.DataFrame, config: Config) -> Study:
    """Each reading's table, and how far it is from the paper's."""
    names = {(t, c): f"{t}_{c}" for t in TABLE for c in CELLS}
    keys = ["phantom", "reading", "seed"]
    wide = rows.pivot(index=keys, columns="method", values=CELLS).swaplevel(axis=1)[list(names)]
    paper = [TABLE[t][CELLS.index(c)] for t, c in names]
    table = wide.set_axis(list(names.values()), axis=1)
    table["log_rms"] = np.sqrt((np.log(wide / paper) ** 2).mean(axis=1))
    groups = table.log_rms.groupby(level=["phantom", "reading"])
    figure = Figure((6.8, 3.0), layout="constrained")
    phantoms, order = rows.phantom.unique(), rows.reading.unique()
    axes = figure.subplots(1, len(phantoms), sharex=True, sharey=True, squeeze=False)[0]
    for axis, phantom in zip(axes, phantoms, strict=True):
        distances = [groups.get_group((phantom, reading)) for reading in order]
        axis.boxplot(distances, orientation="horizontal", whis=(0, 100))
        axis.set(title=f"phantom: {phantom}", xlabel="rms of ln(ours / paper)")
        axis.set_yticks(range(1, len(order) + 1), order)
        axis.axvline(0.12, color="0.6", linewidth=0.5)
    axes[0].invert_yaxis()
    axes[0].set_xlim(left=0)
    axes[0].set_ylabel("warped by, R on, ends, lengths")
    numbers: Numbers = {}
    for phantom in phantoms:
        some = table.log_rms[phantom]
        nearest = some.unstack("reading").idxmin(axis=1)
        for reading in order:
            found = some[reading]
            numbers.setdefault(short(phantom), {})[short(reading)] = {
                "median": float(found.median()),
                "least": float(found.min()),
                "most": float(found.max()),
                "nearest": int((nearest == reading).sum()),
                "count": len(found),
                "cells": table.loc[phantom, reading][list(names.values())].median().to_dict(),
            }
    return table.reset_index(), figure, numbers


def ensemble_table(rows: pd.DataFrame, config: Config) -> Study:
    """Median and 5 to 95 % of each cell of Table 1, and how often two tests are in an order."""
    wide = rows.pivot(index="seed", columns="method", values=CELLS).swaplevel(axis=1)
    table = pd.DataFrame(
        {
            "test": t,
            "cell": cell,
            "paper": TABLE[t][k],
            "median": wide[t, cell].median(),
            "low": wide[t, cell].quantile(0.05),
            "high": wide[t, cell].quantile(0.95),
        }
        for t in TABLE
        for k, cell in enumerate(CELLS)
    )
    within = table.paper.between(table.low, table.high)
    orders = {
        f"{s}<{t}": float((wide[s, "e_rel"] < wide[t, "e_rel"]).mean())
        for s, t in permutations(TABLE, 2)
    }
    figure = Figure((6.8, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[2, 1])
    place = np.arange(len(table))
    spread = np.abs(table[["low", "high"]].sub(table["median"], axis=0)).to_numpy().T
    left.errorbar(place, table["median"], spread, fmt="o", markersize=3, label="ours, 5 to 95 %")
    left.plot(place, table.paper, "kx", label="the paper's")
    left.set_xticks(
        place,
        [
            f"{t}\n{c.replace('e_rel_', '').replace('e_rel', 'u')}"
            for t, c in zip(table.test, table.cell, strict=True)
        ],
    )
    left.set(xlabel="test, component", ylabel="relative error [%]", ylim=(0, None))
    left.legend(frameon=False)
    share = np.array([[orders.get(f"{s}<{t}", np.nan) for t in TABLE] for s in TABLE])
    heat(right, share, list(TABLE), list(TABLE), "viridis", (0, 1))
    for (i, j), value in np.ndenumerate(share):
        if i != j:
            colour = "w" if value < 0.6 else "k"
            right.text(j, i, f"{value:.2g}", ha="center", va="center", color=colour)
    right.set(xlabel="than test", ylabel="test is better", title="part of the seeds")
    numbers: Numbers = {"order": {k.replace("<", "_before_"): v for k, v in orders.items()}}
    numbers |= {"within": int(within.sum()), "cells": len(table), "seeds": len(wide)}
    papers = sorted(TABLE, key=lambda t: TABLE[t][0])
    kept = [
        all(wide[s, "e_rel"][seed] < wide[t, "e_rel"][seed] for s, t in pairwise(papers))
        for seed in wide.index
    ]
    numbers |= {"whole_order": float(np.mean(kept))}
    for row in table.to_dict("records"):
        numbers.setdefault(f"test{row.pop('test')}", {})[row.pop("cell")] = row
    return table, figure, numbers


def parameters_study(rows: pd.DataFrame, config: Config) -> Study:
    """Error of test 5 over alpha and beta, and over alpha and sigma."""
    kinds, maps = rows.bubbles_kind.unique(), {"alpha and beta": "beta", "alpha and sigma": "sigma"}
    figure = Figure((7.2, 4.8), layout="constrained")
    axes = figure.subplots(2, len(kinds), squeeze=False)
    chosen, numbers, means = config.variant("5"), {}, []
    for line, (name, other) in zip(axes, maps.items(), strict=True):
        keys = ["bubbles_kind", other, "alpha"]
        errors = rows[rows["map"] == name].groupby(keys).e_rel.mean()
        limits = np.log10([errors.min(), errors.max()])
        for axis, kind in zip(line, kinds, strict=True):
            mean = errors[kind].unstack()
            values = np.log10(mean.to_numpy())
            shown = heat(axis, values, mean.columns, mean.index, "viridis_r", limits)
            own = (getattr(chosen, other), chosen.alpha)
            found = numbers.setdefault(short(kind), {}).setdefault(other, {})
            for role, mark, at in (("best", "wo", errors[kind].idxmin()), ("paper", "r*", own)):
                if at in errors[kind].index:
                    x, y = mean.columns.get_loc(at[1]), mean.index.get_loc(at[0])
                    axis.plot(x, y, mark, markersize=7, markeredgecolor="k")
                    e = float(errors[kind][at])
                    found[role] = {"e_rel": e, other: float(at[0]), "alpha": float(at[1])}
            axis.set(xlabel="alpha", ylabel=other, title=kind)
        bar = figure.colorbar(shown, ax=line, label="relative error of test 5 [%]")
        bar.ax.yaxis.set_major_formatter(lambda value, _: f"{10**value:.3g}")
        means.append(errors.reset_index().rename(columns={"bubbles_kind": "bubbles"}))
    columns = ["bubbles", "alpha", "beta", "sigma", "e_rel"]
    return pd.concat(means).reindex(columns=columns), figure, numbers


def demands(rows: pd.DataFrame, config: Config) -> Study:
    """Error of test 5, the preset and test 6 over one thing at a time."""
    keys = ["demand", "value", "method"]
    table = rows.groupby(keys, sort=False).e_rel.mean().unstack().reset_index()
    refused = rows[rows.refused.notna()].groupby(keys).size()
    names = list(rows.demand.unique())
    figure = Figure((7.6, 4.4), layout="constrained")
    axes = figure.subplots(2, (len(names) + 1) // 2, sharey=True).ravel()
    numbers: Numbers = {}
    for axis, name in zip(axes, names, strict=False):
        some = table[table.demand == name].sort_values("value")
        place = np.arange(len(some))
        for method, label in METHODS.items():
            if method not in some:
                continue
            axis.plot(place, some[method], "o-", markersize=3, linewidth=1, label=label)
            numbers.setdefault(short(name), {})[f"method{method}"] = {
                f"at{number(value)}": error
                for value, error in zip(some.value, some[method], strict=True)
                if error == error
            }
        axis.set_xticks(place, [f"{value:g}" for value in some.value], rotation=45)
        axis.set(yscale="log", xlabel=name)
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.grid(axis="y", which="both", linewidth=0.2)
    for axis in axes[:: len(axes) // 2]:
        axis.set_ylabel("relative error of u [%]")
    axes[0].legend(frameon=False, fontsize=7)
    numbers["refused"] = {f"{short(d)}_{number(v)}_{m}": int(n) for (d, v, m), n in refused.items()}
    return table.rename(columns=METHODS), figure, numbers


def fits(rows: pd.DataFrame, config: Config) -> Study:
    """The course of the searches, and the parameters of the best phantoms of each."""
    names, ours = list(BOUNDS), parameters(config)
    low, high = np.array(list(BOUNDS.values())).T
    figure = Figure((7.2, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    numbers: Numbers = {"searches": {}, "evaluations": int(rows.groupby("search").size().max())}
    bests = []
    for number_, found in rows.groupby("search"):
        best = found.drop_duplicates(names).nsmallest(BEST, "distance")
        bests.append(best)
        left.plot(np.arange(1, len(found) + 1), found.distance.cummin(), label=f"search {number_}")
        part = (best[names] - low) / (high - low)
        place = np.tile(np.arange(len(names)), (len(best), 1)) + 0.15 * (number_ - 2)
        right.plot(place.ravel(), part.to_numpy().ravel(), "o", markersize=2.5, alpha=0.6)
        numbers["searches"][f"search{number_}"] = {
            "least": float(best.distance.min()),
            "tenth": float(best.distance.max()),
        }
    right.plot(
        np.arange(len(names)), (ours - low) / (high - low), "k_", markersize=12, label="configured"
    )
    right.set_xticks(np.arange(len(names)), names, rotation=60)
    right.set(
        ylabel="part of the bounds", title=f"the {BEST} best of each search", ylim=(-0.05, 1.05)
    )
    left.set(xlabel="phantoms tried", ylabel="least distance from the paper", yscale="log")
    for axis in (left, right):
        axis.legend(frameon=False, fontsize=7)
    best = pd.concat(bests)
    for name, l, h, own in zip(names, low, high, ours, strict=True):
        values = best[name]
        numbers[name] = {
            "least": float(values.min()),
            "most": float(values.max()),
            "configured": float(own),
        }
        numbers[name]["part"] = float((values.quantile(0.9) - values.quantile(0.1)) / (h - l))
    return rows, figure, numbers


def theory(rows: pd.DataFrame, config: Config) -> Study:
    """Convergence, Lipschitz constants, uniqueness and weak edges."""
    labels = {
        "convergence": ("size of a cell", "root mean square error"),
        "dependence": ("alpha", "|v| / |b| (H1 and its dual)"),
        "independence": ("part of the second direction in grad I", "coercivity"),
        "weak edges": ("weight of B", "largest distance, px"),
    }
    figure = Figure((7.2, 5.0), layout="constrained")
    numbers: Numbers = {}
    for axis, (part, (x, y)) in zip(figure.subplots(2, 2).ravel(), labels.items(), strict=True):
        for series, found in rows[rows.part == part].groupby("series", sort=False):
            shown = found[(found.x > 0) & (found.y > 0)]
            # Some lie upon each other.
            size = 5 - len(axis.lines)
            axis.loglog(shown.x, shown.y, "o-", markersize=size, linewidth=size / 2, label=series)
            numbers.setdefault(short(part), {})[short(series)] = {
                "slope": slope(shown),
                **{f"at{number(a)}": float(b) for a, b in zip(found.x, found.y, strict=True)},
            }
        axis.set(xlabel=x, ylabel=y, title=part)
        axis.legend(frameon=False, fontsize=7)
    refused = rows[rows.refused.notna()]
    numbers["refused"] = {
        f"at{number(x)}": text for x, text in zip(refused.x, refused.refused, strict=True)
    }
    return rows.assign(y=rows.y.map("{:.6g}".format)), figure, numbers


def slope(rows: pd.DataFrame) -> float:
    """Of a line through the logarithms; no value of one point."""
    if len(rows) < 2:
        return 0.0
    return float(np.polyfit(np.log(rows.x), np.log(rows.y), 1)[0])


def heat(axis: Axes, values: Any, columns: Any, lines: Any, colours: str, limits: Any) -> Any:
    """A map with a cell for each value, labelled."""
    shown = axis.imshow(
        values, colours, origin="lower", aspect="auto", vmin=limits[0], vmax=limits[1]
    )
    for set_ticks, ticks in ((axis.set_xticks, columns), (axis.set_yticks, lines)):
        set_ticks(range(len(ticks)), [t if isinstance(t, str) else f"{t:.3g}" for t in ticks])
    axis.tick_params(axis="x", rotation=60 if len(columns) > 5 else 0)
    return shown


def short(text: str) -> str:
    """A label as a key: words joined by underscores."""
    return "_".join("".join(c if c.isalnum() else " " for c in str(text)).split())


def number(value: float) -> str:
    """A value as a key."""
    return f"{value:g}".replace(".", "_").replace("-", "m")


STUDIES: dict[str, Callable[[pd.DataFrame, Config], Study]] = {
    "readings": readings,
    "ensemble_table": ensemble_table,
    "parameters": parameters_study,
    "demands": demands,
    "fits": fits,
    "theory": theory,
}

study, config = snakemake.params.study, Config(**snakemake.params.config)
parts = [pd.read_csv(path, dtype={"method": str}) for path in snakemake.input.parts]
with mpl.rc_context(STYLE):
    table, figure, numbers = STUDIES[study](pd.concat(parts, ignore_index=True), config)
io.write_table(Path(snakemake.output.csv), table)
io.write_json(Path(snakemake.output.json), numbers)
save(figure, [Path(snakemake.output.png), Path(snakemake.output.pdf)], config.figures)
Path(snakemake.log[0]).write_text(f"{len(table)} rows\n")
