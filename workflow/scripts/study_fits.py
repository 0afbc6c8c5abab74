"""A search for the phantom from anywhere: the parameters and the distance of all it tried."""

from pathlib import Path

import numpy as np
import pandas as pd
from search_phantom import BOUNDS, candidate, distance, search
from tqdm import tqdm

from eofm import io
from eofm.app.config import Config
from eofm.compiled import use_threads
from eofm.errors import InputError

use_threads(snakemake.threads)
config, part = Config(**snakemake.params.config), int(snakemake.wildcards.part)
config = config.changed(forward=config.forward.changed(background_error=0.01))
evaluations, rows = snakemake.params.evaluations, []
with Path(snakemake.log[0]).open("w") as log, tqdm(total=evaluations, file=log) as bar:

    def score(x: np.ndarray) -> float:
        """Distance of a phantom from the paper; bubbles that cannot be tracked are far away."""
        try:
            found = distance(candidate(config, x), snakemake.params.bubbles)
        except InputError:
            found = 10.0
        rows.append({"search": part + 1, "distance": found} | dict(zip(BOUNDS, x, strict=True)))
        bar.set_postfix_str(f"least distance {min(row['distance'] for row in rows):.3f}")
        bar.update()
        return found

    population = min(15, evaluations // 2)
    search(config, score, evaluations=evaluations, population=population, seed=100 + part)
io.write_table(Path(snakemake.output[0]), pd.DataFrame(rows))
