"""One table of all samples, and a page that shows it with their figures."""

import html
import json
import os
from pathlib import Path

import pandas as pd

from eofm.io import replacing

FIRST = ["sample", "state", "reason", "verdict", "seconds"]

states = [json.loads(Path(file).read_text()) for file in snakemake.input.states]
table = pd.DataFrame(states, columns=[*FIRST, *sorted({k for s in states for k in s} - {*FIRST})])
table = table.drop(columns="key", errors="ignore")
with replacing(Path(snakemake.output.csv)) as temporary:
    table.to_csv(temporary, index=False, float_format="%.6g")

page = Path(snakemake.output.page)
page.mkdir(parents=True, exist_ok=True)
lines = ["<!doctype html><meta charset=utf-8><title>Samples</title>", table.to_html(index=False)]
for file in map(Path, snakemake.input.states):
    name = file.parent.name
    for figure in sorted(file.parent.glob("*.png")):
        shown = f"{name}-{figure.name}"
        os.link(figure, page / shown)
        lines += [f"<h2>{html.escape(figure.stem)} of {html.escape(name)}</h2>"]
        lines += [f'<img src="{html.escape(shown)}" style="max-width: 100%">']
(page / "index.html").write_text("\n".join(lines) + "\n")
