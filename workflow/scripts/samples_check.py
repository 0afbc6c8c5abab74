"""Say which samples have no results, and end with 1 if there are any."""

import sys

import pandas as pd

table = pd.read_csv(sys.argv[1], dtype=str, keep_default_na=False)
broken = table[table.state != "done"]
for row in broken.itertuples():
    print(f"{row.sample}: {row.state}: {row.reason}", file=sys.stderr)
if len(broken):
    sys.exit(f"{len(broken)} of {len(table)} samples have no results; the others are complete")
