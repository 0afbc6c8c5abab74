"""Say which samples have no results, and end with 1 if there are any.

The states of those that crashed are removed, so that the next run tries them again.
"""

import sys
from pathlib import Path

import pandas as pd
from sample_rows import CRASHED, READY, STATE

file = Path(sys.argv[1])
table = pd.read_csv(file, dtype=str, keep_default_na=False)
broken = table[table.state != READY]
for row in broken.itertuples():
    print(f"{row.sample}: {row.state}: {row.reason}", file=sys.stderr)
    if row.state == CRASHED:
        (file.parent / row.sample / STATE).unlink(missing_ok=True)
if len(broken):
    sys.exit(f"{len(broken)} of {len(table)} samples have no results; the others are complete")
