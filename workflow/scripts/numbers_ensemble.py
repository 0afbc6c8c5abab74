"""What texts quote of the ensemble and of the benchmark: medians, and the errors at one size."""

from pathlib import Path

import pandas as pd
from record import record

SIZE = 1024
# Largest noise of images that count as clean, of the brightest bubble.
CLEAN = 0.02


def ensemble() -> dict[str, dict]:
    """Medians over the phantoms that nothing was tuned on, of tools that are installed."""
    table = pd.read_csv(snakemake.input.table).drop(columns="phantom")
    reported = table[table.half == "reported"]
    clean = reported[reported.noise <= CLEAN]
    return {
        "count": {"all": len(table), "reported": len(reported), "clean": len(clean)},
        "median": reported.median(numeric_only=True).dropna().to_dict(),
        "clean": clean.median(numeric_only=True).dropna().to_dict(),
        "verdicts": reported.verdict.value_counts().to_dict(),
    }


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
