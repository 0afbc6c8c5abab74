"""One table of all samples, as CSV and as pages."""

import json
from pathlib import Path

import pandas as pd
from samples_page import page, table

from eofm.io import replacing

FIRST = ["sample", "state", "reason", "verdict", "seconds"]

states = [json.loads(Path(file).read_text()) for file in snakemake.input.states]
columns = [*FIRST, *sorted({k for s in states for k in s} - {*FIRST})]
rows = pd.DataFrame(states, columns=columns).drop(columns="key", errors="ignore")
with replacing(Path(snakemake.output.csv)) as temporary:
    rows.to_csv(temporary, index=False, float_format="%.6g")
folder = Path(snakemake.output.csv).parent
with replacing(Path(snakemake.output.page)) as temporary:
    temporary.write_text(page(states, folder), encoding="utf-8")
# For the first page of the report, which lies beside the folder results.
with replacing(Path(snakemake.output.table)) as temporary:
    temporary.write_text(table(states, folder, folder.as_posix()), encoding="utf-8")
