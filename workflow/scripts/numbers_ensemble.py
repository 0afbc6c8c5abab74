"""What texts quote of the ensemble and of the benchmark: medians, and the errors at one size."""

from pathlib import Path

import pandas as pd
from record import record

SIZE = 1024


def ensemble() -> dict[str, dict[str, float]]:
    """Median of each column over the phantoms, of tools that are installed."""
    table = pd.read_csv(snakemake.input.table).drop(columns="phantom")
    return {"median": table.median().dropna().to_dict()}


def benchmark() -> dict[str, dict]:
    """All tools at one size, and the solver's iterations at all sizes."""
    table = pd.read_csv(snakemake.input.table)
    iterations = pd.read_csv(snakemake.input.solver).iterations
    at_size = table[table["size"] == SIZE].drop(columns="size").set_index("tool")
    return {
        "size": {"px": SIZE},
        "tools": {tool: row.dropna().to_dict() for tool, row in at_size.iterrows()},
        "solver": {"fewest": int(iterations.min()), "most": int(iterations.max())},
    }


values = {"ensemble": ensemble, "benchmark": benchmark}[snakemake.params.name]()
record(Path(snakemake.output[0]), snakemake.params.command, values)
