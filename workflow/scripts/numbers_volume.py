"""What texts quote of volumes: errors of the virtual sample, and the benchmark by case and size."""

from pathlib import Path

import pandas as pd
from record import record

errors = pd.read_csv(snakemake.input.errors)
table = pd.read_csv(snakemake.input.benchmark).dropna(subset="seconds")
values: dict[str, dict] = {
    images: rows.drop(columns="images").set_index("method").e_rel.to_dict()
    for images, rows in errors.groupby("images")
}
for (case, size), rows in table.groupby(["case", "size"], sort=False):
    rows = rows.drop(columns=["case", "size"]).set_index(rows.tool.str.replace(" ", "_"))
    rows = rows.drop(columns="tool")
    values[f"{case}_{size}"] = {tool: row.dropna().to_dict() for tool, row in rows.iterrows()}
# The sizes that were run, which may be fewer than the configuration's.
sizes = sorted(set(table["size"].astype(int)))
command = f"{snakemake.params.command} --config 'benchmark_volume={{sizes: {sizes}}}'"
record(Path(snakemake.output[0]), command, values)
