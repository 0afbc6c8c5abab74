"""A table of all samples: as CSV, for the first page of the report, and with their own pages."""

import html
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile

from eofm.analysis.findings import Units
from eofm.analysis.pictures import png
from eofm.io import replacing

# Files of the table.
CSV, HTML, PART = "summary.csv", "index.html", "table.html"
FIRST = ["sample", "state", "reason", "verdict", "seconds"]

# Samples that are shown, and bytes of their own pages that go into one page.
SHOWN, EMBEDDED = 500, 8_000_000
SIDE = 96
COLOURS = {"good": "#2f7d56", "doubtful": "#b45f06", "failed": "#b3261e"}
CELL = "padding: 4px 14px 4px 0; text-align: left; vertical-align: middle;"
NARROW = CELL + " white-space: nowrap; border-top: 1px solid #8884"
HEAD = ("sample", "axial motion", "state", "motion, least to most", "axial strain", "seconds")

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Samples</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root { color-scheme: light dark; }
body { font: 15px/1.45 system-ui, sans-serif; margin: 1.2rem; }
dialog { width: 96vw; height: 94vh; max-width: none; max-height: none; padding: 0; }
iframe { width: 100%; height: calc(100% - 2.4rem); border: 0; }
</style></head><body>
<h1>Samples</h1>
TABLE
<dialog><form method="dialog"><button>Back to the table</button></form><iframe></iframe></dialog>
PAGES
<script>
const dialog = document.querySelector("dialog");
for (const link of document.querySelectorAll("a[data-sample]")) {
  const page = document.getElementById("page-" + link.dataset.sample);
  if (page) link.addEventListener("click", (event) => {
    event.preventDefault();
    dialog.querySelector("iframe").srcdoc = JSON.parse(page.textContent);
    dialog.showModal();
  });
}
</script></body></html>
"""


def write(states: list[dict[str, Any]], folder: Path) -> None:
    """Write the table in all its forms to the folder of the samples' folders."""
    columns = [*FIRST, *sorted({k for s in states for k in s} - {*FIRST})]
    rows = pd.DataFrame(states, columns=columns).drop(columns="key", errors="ignore")
    with replacing(folder / CSV) as temporary:
        rows.to_csv(temporary, index=False, float_format="%.6g")
    with replacing(folder / HTML) as temporary:
        temporary.write_text(page(states, folder), encoding="utf-8")
    # For the first page of the report, which lies beside the folder results.
    with replacing(folder / PART) as temporary:
        temporary.write_text(table(states, folder, folder.as_posix()), encoding="utf-8")


def table(states: list[dict[str, Any]], folder: Path, links: str) -> str:
    """A row for each sample, with a link to its page.

    Parameters
    ----------
    states : list of dict
        What each row says of itself.
    folder : Path
        Folder of their folders.
    links : str
        That folder as links are to name it.
    """
    head = "".join(f'<th style="{CELL}">{name}</th>' for name in HEAD)
    rows = "".join(_row(state, folder, links) for state in states[:SHOWN])
    more = len(states) - SHOWN
    note = f"<p>{more} more are in summary.csv.</p>" if more > 0 else ""
    shown = f'<table style="border-collapse: collapse"><tr>{head}</tr>{rows}</table>'
    return f'<div style="overflow-x: auto">{shown}</div>{note}'


def page(states: list[dict[str, Any]], folder: Path) -> str:
    """The table, and the pages of the samples as far as they are small together."""
    pages, room = "", EMBEDDED
    for state in states[:SHOWN]:
        file = folder / state["sample"] / "report.html"
        if file.is_file() and (room := room - file.stat().st_size) >= 0:
            # In a script, a tag that ends one would end it.
            text = json.dumps(file.read_text(encoding="utf-8")).replace("</", "<\\/")
            name = html.escape(state["sample"])
            pages += f'<script type="application/json" id="page-{name}">{text}</script>\n'
    return PAGE.replace("TABLE", table(states, folder, ".")).replace("PAGES", pages)


def _row(state: dict[str, Any], folder: Path, links: str) -> str:
    name, verdict = html.escape(state["sample"]), state.get("verdict", state["state"])
    colour = COLOURS.get(verdict, "#b3261e")
    cells = [name, "", f'<b style="color: {colour}">{html.escape(verdict)}</b>']
    summary = folder / state["sample"] / "summary.json"
    motion, strain = "", ""
    if state["state"] == "done" and summary.is_file():
        values = json.loads(summary.read_text())
        cells[0] = f'<a data-sample="{name}" href="{links}/{name}/report.html">{name}</a>'
        cells[1] = _thumbnail(summary.parent, values)
        motion = "<br>".join(_ranges(values))
        strain = f"{100 * values['axial_strain_mean']:.2f} %"
    cells += [motion, strain, f"{state['seconds']:.3g}" if "seconds" in state else ""]
    rows = "<tr>" + "".join(f'<td style="{NARROW}">{cell}</td>' for cell in cells) + "</tr>\n"
    if reason := html.escape(state.get("reason", "")):
        # Below, where it has room.
        rows += f'<tr><td></td><td style="{CELL}" colspan="{len(HEAD) - 1}">{reason}</td></tr>\n'
    return rows


def _ranges(summary: dict[str, Any]) -> list[str]:
    units = Units(summary)
    unit = "px" if units.name == "px" else "um"
    ranges = [summary[f"u{i + 1}_range_{unit}"] for i in range(len(summary["pixel_size_um"]))]
    return [f"u{i}: {a:.3g} to {b:.3g} {units.name}" for i, (a, b) in enumerate(ranges, 1)]


def _thumbnail(place: Path, summary: dict[str, Any]) -> str:
    u = tifffile.memmap(place / "displacement.tif", mode="r")
    axial = u[1] if u.ndim == 3 else u[:, 1]
    # Of volumes in tiles, only the sections are read.
    ends = summary["u2_range_px"] if "tiles" in summary else (np.nanmin(axial), np.nanmax(axial))
    low, high = map(float, ends)
    high = high if high > low else low + 1
    address, (width, height) = png(axial, (low, high), "viridis", summary["pixel_size_um"], SIDE)
    scale = SIDE / max(width, height)
    size = f'width="{max(8, round(scale * width))}" height="{max(8, round(scale * height))}"'
    return f'<img src="{address}" alt="axial motion" {size}>'
