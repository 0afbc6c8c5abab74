"""Table 1: relative and largest errors of the tests, beside the paper's."""

from pathlib import Path

import pandas as pd
from paper import LARGEST, TABLE

from eofm import io
from eofm.analysis.metrics import relative_errors
from eofm.grid import Array

PAPER = ["paper_e_rel", "paper_e_rel_u1", "paper_e_rel_u2"]


def evaluate(estimate: str, truth: Array, path: str) -> pd.DataFrame:
    """Errors of one field, which are also written to a file: a row with their names."""
    row = pd.DataFrame([relative_errors(io.read_field(Path(estimate)), truth)])
    io.write_table(Path(path), row)
    return row


def collect(errors: dict[str, pd.DataFrame], tests: dict[str, dict]) -> pd.DataFrame:
    """One row per test, with the settings that tell the paper's tests apart."""
    rows = []
    for name, found in errors.items():
        row = {"test": name}
        if name in tests:
            estimation = tests[name]
            row |= {name: estimation[name] for name in ("alpha", "beta")}
            row["multiscale"] = "yes" if estimation["scales"] > 1 else "no"
        row |= found.iloc[0].to_dict()
        row |= dict(zip(PAPER, TABLE.get(name, ()), strict=False))
        rows.append(row)
    columns = ["test", "alpha", "beta", "multiscale", *found.columns, *PAPER]
    return pd.DataFrame(rows).reindex(columns=columns)


def largest(table: pd.DataFrame) -> pd.DataFrame:
    """Largest errors in px, beside those that the paper quotes."""
    columns = ["max_error_u1", "max_error_u2"]
    paper = pd.DataFrame.from_dict(
        LARGEST, orient="index", columns=[f"paper_{name}" for name in columns]
    )
    return table[["test", *columns]].join(paper, on="test")


def for_people(table: pd.DataFrame) -> pd.DataFrame:
    """The table with readable heads and units, rounded as in the paper."""
    heads = {
        "test": "Test",
        "alpha": "α",
        "beta": "β",
        "multiscale": "Multi-scale",
        "e_rel": "e_rel(u) %",
        "e_rel_u1": "e_rel(u1) %",
        "e_rel_u2": "e_rel(u2) %",
        "max_error_u1": "max |error of u1| px",
        "max_error_u2": "max |error of u2| px",
    }
    heads |= {name: f"paper: {heads[name.removeprefix('paper_')]}" for name in PAPER}
    shown = table.rename(columns=heads)
    shown["Test"] = [
        f"{name} (ours)" if name in snakemake.params.ours else name for name in table.test
    ]
    weights = [heads["alpha"], heads["beta"]]
    shown[weights] = shown[weights].map("{:g}".format, na_action="ignore")
    return shown


truth = io.read_field(Path(snakemake.input.truth))
names = [Path(path).parent.name for path in snakemake.output.errors]
fields = [snakemake.input.background, *snakemake.input.tests]
errors = {
    name: evaluate(field, truth, path)
    for name, field, path in zip(names, fields, snakemake.output.errors, strict=True)
}
table = collect(errors, snakemake.params.tests)
io.write_table(Path(snakemake.output.csv), table)
io.write_table(Path(snakemake.output.largest), largest(table))
style = for_people(table).style.hide(axis="index").format(na_rep="–", precision=2)
with io.replacing(Path(snakemake.output.html)) as path:
    style.set_table_styles(
        [
            {"selector": "", "props": "border-collapse: collapse; font: 14px sans-serif"},
            {"selector": "th, td", "props": "padding: 4px 10px; text-align: right"},
            {"selector": "thead th", "props": "border-bottom: 1px solid; max-width: 6em"},
        ]
    ).set_caption("Relative and largest errors of the estimated fields.")
    path.write_text(style.to_html(doctype_html=True, table_uuid="table1"))
latex = for_people(table)
latex.columns = latex.columns.str.replace(r"e_rel\((u\d?)\)", r"$e_{rel}(\1)$", regex=True)
latex.columns = latex.columns.str.translate(
    str.maketrans({"%": r"\%", "α": r"$\alpha$", "β": r"$\beta$", "|": r"$\vert$"})
)
with io.replacing(Path(snakemake.output.tex)) as path:
    styler = latex.style.hide(axis="index").format(na_rep="--", precision=2)
    path.write_text(
        styler.to_latex(hrules=True, column_format="l" + "r" * (len(latex.columns) - 1))
    )
