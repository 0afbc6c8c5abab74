"""Some of the cases of a study: a row for each case and method."""

from pathlib import Path

import pandas as pd
from study import ERRORS, cases, run
from tqdm import tqdm

from eofm import io
from eofm.app.config import Config
from eofm.compiled import use_threads

use_threads(snakemake.threads)
table, config = snakemake.params.table, Config(**snakemake.params.config)
found = cases(table["cases"], snakemake.params.values, snakemake.params.cases)
part, parts = int(snakemake.wildcards.part), snakemake.params.parts
# In a row, so that cases with the same sample share its fields.
some = found[len(found) * part // parts : len(found) * (part + 1) // parts]
rows = []
with Path(snakemake.log[0]).open("w") as log:
    for labels, changes in tqdm(some, snakemake.wildcards.study, file=log):
        rows += [labels | row for row in run(config, changes, table["methods"])]
columns = [*dict.fromkeys(name for labels, _ in found for name in labels)]
columns += ["method", "bubbles", *ERRORS, "refused"]
io.write_table(Path(snakemake.output[0]), pd.DataFrame(rows).reindex(columns=columns))
