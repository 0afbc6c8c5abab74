"""What texts quote of the paper's experiment: Table 1, the virtual OCT, bubbles, seeds."""

from pathlib import Path

import pandas as pd
from record import record, rows

import eofm
from eofm import io
from eofm.app.config import Config
from eofm.grid import Array

SEEDS = range(2, 11)
ERRORS = ["e_rel", "e_rel_u1", "e_rel_u2"]


def seeds(config: Config, truth: Array, background: Array) -> dict[str, float]:
    """Changes of the cells of Table 1 with other seeds of the bubbles, percent."""
    table = pd.read_csv(snakemake.input.table, dtype={"test": str}).set_index("test")
    changes = []
    for seed in SEEDS:
        I1, I2, _ = eofm.make_phantom(truth, config.phantom.changed(seed=seed))
        bubbles = eofm.track(I1, I2, config.tracking, prediction=background)
        for name, variant in config.tests.items():
            known = eofm.Known(bubbles, background if variant.background else None)
            found = eofm.estimate_displacement(I1, I2, config.variant(name), known)
            errors = pd.Series(eofm.relative_errors(found.u, truth))[ERRORS]
            changes.append((errors / table.loc[name, ERRORS] - 1).abs())
    cells = 100 * pd.DataFrame(changes).stack().astype(float)
    return {"count": len(SEEDS), "median_change": cells.median(), "largest_change": cells.max()}


given = {name: Path(path) for name, path in snakemake.input.items() if isinstance(path, str)}
config = Config.parse(snakemake.params.config, "configuration")
truth, background = io.read_field(given["truth"]), io.read_field(given["background"])
values = {
    "table": rows(given["table"], "test"),
    "largest": rows(given["largest"], "test"),
    "virtual_oct": rows(given["virtual_oct"], "method"),
    "bubbles": {"count": config.phantom.count, "tracked": len(pd.read_csv(given["bubbles"]))},
    "seeds": seeds(config, truth, background),
}
record(Path(snakemake.output[0]), snakemake.params.command, values)
