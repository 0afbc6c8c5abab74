"""What texts quote of the robustness table: of the half that nothing was tuned on."""

from pathlib import Path

import pandas as pd
from record import record

# The preset as it is, and other settings of it.
OURS = ["preset", "preset_plain", "preset_local"]
# An error that counts as a failure: px, and as a multiple of that of the clean pair.
FAILED, TIMES = 1.0, 10.0


def conditions(held: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Of each condition: medians over scenes, and the preset over the best other tool."""
    errors = held.pivot(index=["condition", "pair"], columns="tool", values="error_px")
    others = errors.drop(columns=OURS)
    errors["best"] = others.min(axis=1)
    errors["ratio"] = errors["preset"] / errors["best"]
    summary = errors.groupby("condition", sort=False).median()
    summary["worst_ratio"] = errors.groupby("condition", sort=False)["ratio"].max()
    return {name: row.dropna().to_dict() for name, row in summary.iterrows()}


def verdicts(preset: pd.DataFrame) -> dict[str, float]:
    """How many estimates fail, of how many of them the verdict tells, and what good ones hear."""
    failed = (preset.error_px > FAILED) | (preset.ratio_to_clean > TIMES) | preset.error_px.isna()
    told = preset.verdict != "good"
    return {
        "failed": int(failed.sum()),
        "told": int((failed & told).sum()),
        "good": int((~failed).sum()),
        "doubted": int((~failed & told).sum()),
    }


table = pd.read_csv(snakemake.input.table, keep_default_na=False, na_values=[""])
held = table[table.half == "held"]
preset = held[held.tool == "preset"]
values = {
    "count": {"pairs": len(preset), "scenes": preset["pair"].nunique()},
    "median": held.groupby("tool")["error_px"].median().dropna().to_dict(),
    "conditions": conditions(held),
    "verdicts": verdicts(preset),
    "coverage": preset[["coverage_1", "coverage_196"]].median().to_dict(),
}
record(Path(snakemake.output[0]), snakemake.params.command, values)
