"""Time, memory and errors of one tool on two volumes, which are all that it is given."""

import time
from contextlib import redirect_stdout
from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd
import peers
from measure import measure, resident

import eofm
from eofm import io
from eofm.compiled import use_threads
from eofm.imaging.intensity import normalise

# Side of the part of the volumes on which everything is imported and compiled, voxels; al-dvc
# takes no volume of 32.
SMALL, SMALL_ALDVC = 24, 48
# Volumes that are larger than this are done by two threads, whose time passes on the wall.
LARGE = 128
# Voxels that al-dvc leaves out at either side.
EDGE = 15

tool, case = snakemake.wildcards.tool, snakemake.wildcards.case
size = int(snakemake.wildcards.size)
COLUMNS = ["tool", "size", "case", "seconds", "peak_mb", "mean_error_px"]
COLUMNS += ["rms_at_nodes_px", "coverage", "threads"]


def run(I1, I2):
    """Displacement by the tool, and its estimate if it is ours; None where it is not installed."""
    if tool in peers.VOLUMES:
        return peers.estimate(tool, I1, I2), None
    found = eofm.estimate_displacement(I1, I2, eofm.Estimation(**snakemake.params[tool]))
    return found.u, found


truth = io.read_field(Path(snakemake.input.truth))
I1, I2 = normalise(*io.read_pair(Path(snakemake.input.reference), Path(snakemake.input.deformed)))
threads, clock = (2, time.perf_counter) if size > LARGE else (1, time.process_time)
row = {"tool": tool.replace("_", " "), "size": size, "case": case}
with Path(snakemake.log[0]).open("w") as log, redirect_stdout(log):
    corner = (slice(SMALL_ALDVC if tool == "aldvc" else SMALL),) * 3
    if run(I1[corner], I2[corner])[0] is not None:
        use_threads(threads)
        (u, ours), cost = measure(lambda: run(I1, I2), resident(), clock)
        error = u - truth
        nodes = tuple(slice(EDGE, n - EDGE - 1, peers.NODES) for n in truth.shape[1:])
        row |= cost | {
            "mean_error_px": float(np.nanmean(reduce(np.hypot, error))),
            "rms_at_nodes_px": float(np.sqrt(np.nanmean(error[:, *nodes] ** 2))),
            "threads": threads,
        }
        if tool == "eofm_preset" and size <= LARGE:
            row["coverage"] = float(np.mean(np.abs(error) < ours.deviation()))
io.write_table(Path(snakemake.output[0]), pd.DataFrame([row], columns=COLUMNS))
