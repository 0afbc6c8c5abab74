"""Run a part of the table of samples; see sample_rows.py."""

import sys
from multiprocessing import active_children
from pathlib import Path

from sample_rows import run_rows

if __name__ == "__main__":
    try:
        run_rows(
            snakemake.params.rows,
            Path(snakemake.params.folder),
            list(snakemake.input.code),
            snakemake.threads,
        )
    except OSError as error:  # not even the state of a row can be written
        sys.exit(str(error))
    except KeyboardInterrupt:
        for process in active_children():
            process.terminate()
        sys.exit("interrupted; the next run goes on with the rows that are left")
