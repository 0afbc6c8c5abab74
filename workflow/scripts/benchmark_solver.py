"""Iterations and time of the multigrid solver on the data of one pair of images.

The memory is that of the functional and the solver, without the images.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from measure import measure, peak

from eofm import io
from eofm.flow.functional import Quadratic, data_term
from eofm.flow.multigrid import multigrid
from eofm.grid import Grid
from eofm.imaging.intensity import normalise
from eofm.imaging.splines import gradient

TOLERANCE = 1e-8
LIMIT = 1000
SMALL = 64

image, size, regulariser = (snakemake.wildcards[k] for k in ("image", "size", "regulariser"))
I1, I2 = normalise(*io.read_pair(Path(snakemake.input.reference), Path(snakemake.input.deformed)))


def functional(part: slice, alpha: float) -> Quadratic:
    """The paper's linear problem on a part of the images, with natural boundaries."""
    J1, J2 = I1[part, part], I2[part, part]
    everywhere = np.ones(J1.shape, dtype=bool)
    terms = data_term(gradient(J1), J2 - J1, everywhere)
    return Quadratic(Grid(J1.shape), terms, alpha, everywhere, regulariser)


def iterations(F: Quadratic) -> int:
    """Iterations of the solver to the tolerance."""
    done = [0]
    multigrid(F, tol=TOLERANCE, max_iterations=LIMIT, report=lambda k, _: done.append(k))
    return done[-1]


iterations(functional(slice(SMALL), 1.0))
idle, rows = peak(), []
problem = functional(slice(None), 1.0)
for alpha in snakemake.params.alphas:
    F = replace(problem, alpha=alpha)
    found, cost = measure(lambda F=F: iterations(F), idle)
    row = {"size": int(size), "unknowns": 2 * I1.size, "regulariser": regulariser}
    rows.append(row | {"alpha": alpha, "image": image, "iterations": found} | cost)
io.write_table(Path(snakemake.output[0]), pd.DataFrame(rows))
