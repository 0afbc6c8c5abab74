"""Run a part of the table of samples; see sample_rows.py."""

from pathlib import Path

from sample_rows import run_rows

if __name__ == "__main__":
    run_rows(
        snakemake.params.rows,
        Path(snakemake.params.folder),
        list(snakemake.input.code),
        snakemake.threads,
    )
