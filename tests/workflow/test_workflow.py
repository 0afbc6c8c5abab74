"""The whole workflow on a small configuration, in a copy of the project."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

from eofm.analysis.metrics import relative_errors
from eofm.io import read_field

sys.path.insert(0, str(Path(__file__).parents[2] / "workflow/scripts"))
from reliability import compare, compare_steps

PARTS = ["Snakefile", "config", "workflow", "profiles", "eofm", "tests/small.yaml"]


pytestmark = pytest.mark.slow


class Project:
    """A copy of the project, whose modules may be edited."""

    def __init__(self, root: Path, source: Path) -> None:
        self.root = root
        self.result: subprocess.CompletedProcess | None = None
        for part in PARTS:
            (root / part).parent.mkdir(parents=True, exist_ok=True)
            copy = shutil.copytree if (source / part).is_dir() else shutil.copy
            copy(source / part, root / part)

    def run(self, *words: str) -> subprocess.CompletedProcess:
        command = [sys.executable, "-m", "snakemake", "--configfile", "config/config.yaml"]
        return subprocess.run(
            [*command, "tests/small.yaml", *words],
            cwd=self.root,
            env=os.environ | {"PYTHONPATH": str(self.root)},
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
        )

    def digest(self) -> dict[str, str]:
        """Checksums of all results but pictures."""
        files = [
            p
            for end in ("tif", "csv", "tex", "html")
            for p in self.root.glob(f"results/**/*.{end}")
        ]
        return {
            str(p.relative_to(self.root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files
        }


def reruns(result: subprocess.CompletedProcess) -> set[str]:
    """The rules that a dry run would run."""
    table = result.stdout.partition("Job stats:")[2].partition("total")[0].splitlines()
    return {line.split()[0] for line in table[3:] if line.strip()}


ROWS = [
    ["sample", "reference", "deformed", "top", "bottom", "scales", "roi", "tiles", "overlap"],
    ["good", "results/phantom/reference.tif", "results/phantom/deformed.tif"]
    + ["fixed", "moved 0 -2", "3", "0 0 70 45"],
    ["edge", "results/phantom/reference.tif", "results/phantom/deformed.tif", "glued"],
    ["missing", "nowhere.tif#2", "results/phantom/deformed.tif"],
    ["tiled", "results/volume/speckle/reference.tif", "results/volume/speckle/deformed.tif"]
    + ["", "", "", "", "2 1 1", "8"],
    ["thin", "results/volume/speckle/reference.tif", "results/volume/speckle/deformed.tif"]
    + ["", "", "", "", "2 1 1", "20"],
    ["# a comment"],
]


@pytest.fixture(scope="session")
def project(tmp_path_factory, pytestconfig):
    """A project in which all targets have run at once; three samples of five cannot be used."""
    project = Project(tmp_path_factory.mktemp("project"), pytestconfig.rootpath)
    lines = ["\t".join(row + [""] * (9 - len(row))).rstrip("\t") for row in ROWS]
    (project.root / "pairs.tsv").write_text("\n".join(lines) + "\n")
    project.result = project.run(
        # Snakemake looks at its jobs once in a timespan for each job that has ended: by default
        # a hundred times a second in the end, which takes a seventh of a core.
        *("--max-jobs-per-timespan", "100/5s"),
        *("--cores", "2", "all", "accuracy", "samples", "virtual_oct"),
        *("ensemble", "benchmark", "studies", "volume", "benchmark_volume"),
        *("--config", "samples=pairs.tsv"),
    )
    failed = set(re.findall(r"Error in rule (\w+)", project.result.stderr))
    assert failed == {"samples"}, project.result.stderr
    return project


def test_one_bad_sample_fails_the_run_not_the_others(project):
    assert project.result.returncode == 1
    folder = project.root / "results/samples/good"
    assert imread(folder / "displacement.png").std() > 0.05
    assert '"steps": 1' in (folder / "summary.json").read_text()


def test_rows_and_steps_take_about_the_memory_that_is_said_before(project):
    good, *refused = compare(project.root, "pairs.tsv")
    assert len(refused) == 2  # rows in tiles have jobs of their own
    assert 1 / 1.5 < good["mb"] < 1.5
    steps = compare_steps(project.root, (45, 70))
    # Benchmarks look every half second, and miss the largest memory of steps of a second.
    assert all(1 / 1.5 < ratio < 3 for ratio in steps.values()), steps


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("edge", "sample: edge: top: cannot read 'glued'"),
        ("missing", "sample: missing: nowhere.tif: no such file"),
        ("thin", "gather: thin: tiles: 2 of them leave 16 px each"),
    ],
)
def test_a_bad_sample_is_named_in_one_line(project, name, message):
    log = (project.root / f"logs/samples/{name}.log").read_text()
    assert log.startswith(f"eofm {message}")
    assert log.count("\n") == 1
    assert not (project.root / f"results/samples/{name}/summary.json").exists()


def test_table1(project):
    table = pd.read_csv(project.root / "results/table1.csv", dtype={"test": str})
    columns = "test alpha beta multiscale e_rel e_rel_u1 e_rel_u2 max_error_u1 max_error_u2"
    paper = ["paper_e_rel", "paper_e_rel_u1", "paper_e_rel_u2"]
    assert list(table.columns) == [*columns.split(), *paper]
    assert table.test.tolist() == ["background", "1", "2", "3", "4", "5", "5b", "6"]
    assert table.beta.tolist()[1:6] == [0.5, 0, 0, 0.5, 0.5]
    assert table.multiscale.tolist()[1:6] == ["yes", "no", "yes", "no", "yes"]
    assert table[columns.split()[4:]].notna().all(axis=None)
    assert table.paper_e_rel.tolist()[1:6] == [19.22, 31.69, 20.92, 10.21, 6.48]
    assert table.paper_e_rel[6:].isna().all()
    for test, row in table.set_index("test").iterrows():
        errors = pd.read_csv(project.root / f"results/tests/{test}/errors.csv").iloc[0]
        assert row[errors.index].tolist() == errors.tolist()
    assert "6 (ours)" in (project.root / "results/table1.html").read_text()
    assert "10.21" in (project.root / "results/table1.tex").read_text()
    assert "10.21" in (project.root / "results/table1.html").read_text()


def test_largest_errors_stand_beside_the_paper_s(project):
    largest = pd.read_csv(project.root / "results/largest_errors.csv", dtype={"test": str})
    table = pd.read_csv(project.root / "results/table1.csv", dtype={"test": str})
    ours, paper = ["max_error_u1", "max_error_u2"], ["paper_max_error_u1", "paper_max_error_u2"]
    assert list(largest.columns) == ["test", *ours, *paper]
    pd.testing.assert_frame_equal(largest[["test", *ours]], table[["test", *ours]])
    quoted = largest.set_index("test")[paper].dropna()
    assert quoted.to_dict("split")["data"] == [[2.6, 0.6], [0.6, 0.35]]
    assert quoted.index.tolist() == ["1", "5"]


@pytest.mark.parametrize(
    "name", ["figure3", "figure4", "figure5", "figure6", "figure7", "test2", "test4"]
)
def test_figures(project, name):
    assert imread(project.root / f"results/figures/{name}.png").std() > 0.05
    assert (project.root / f"results/figures/{name}.pdf").read_bytes().startswith(b"%PDF")


def test_accuracy_target_beats_test5(project):
    errors = {
        test: pd.read_csv(project.root / f"results/tests/{test}/errors.csv").e_rel[0]
        for test in ("5", "5b", "6")
    }
    assert errors["5b"] < 0.6 * errors["5"]
    assert errors["6"] < 0.6 * errors["5"]
    for name in ("test5b", "test6", "stiffness"):
        assert imread(project.root / f"results/figures/{name}.png").std() > 0.05


def test_a_second_run_finds_nothing_to_do(project):
    assert "Nothing to be done" in project.run("--dry-run", "all", "accuracy", "ensemble").stdout


def test_one_core_gives_the_same_bytes(project, tmp_path):
    again = Project(tmp_path, project.root)
    result = again.run("--cores", "1", "results/table1.csv")
    assert result.returncode == 0, result.stderr
    before, after = project.digest(), again.digest()
    assert len(after) > 15
    assert after == {name: before[name] for name in after}


def test_editing_a_module_reruns_the_rules_that_use_it(project):
    """Which files those are for each rule is tested in test_imports.py."""
    path = project.root / "eofm/imaging/bubbles.py"
    times, text = path.stat(), path.read_bytes()
    path.write_bytes(text + b"\n")
    try:
        rules = reruns(project.run("--dry-run", "results/table1.csv"))
    finally:
        # All as it was, for other tests.
        path.write_bytes(text)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert {"track", "estimate", "table1"} <= rules
    assert not {"phantom", "true_field"} & rules


def test_changing_a_value_reruns_what_depends_on_it(project):
    words = ["--dry-run", "results/table1.csv", "--config", "tracking={gate: 3.0}"]
    rules = reruns(project.run(*words))
    assert {"track", "estimate", "table1"} <= rules
    assert not {"true_field", "phantom"} & rules


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("estimation={alfa: 1}", "unknown key estimation.alfa; did you mean alpha?"),
        ("samples=nowhere.tsv", "nowhere.tsv: cannot be read as a table"),
    ],
)
def test_wrong_configuration_ends_in_one_line(project, setting, message):
    result = project.run("--dry-run", "--config", setting)
    assert result.returncode == 1
    assert message in result.stderr
    assert "Traceback" not in result.stderr


def test_virtual_oct(project):
    folder = project.root / "results/virtual_oct"
    table = pd.read_csv(folder / "errors.csv")
    columns = "method max_error_u1 max_error_u2 median_error max_true_u1 max_true_u2"
    assert list(table.columns) == columns.split()
    assert table.method.tolist() == ["background", "standard", "eofm"]
    assert table.median_error.idxmin() == 2
    for number in (1, 2, 8):
        assert imread(folder / f"figures/figure{number}.png").std() > 0.05
        assert (folder / f"figures/figure{number}.pdf").read_bytes().startswith(b"%PDF")


def test_benchmark(project):
    folder = project.root / "results/benchmark"
    table = pd.read_csv(folder / "estimate.csv")
    assert list(table.columns) == ["tool", "size", "seconds", "peak_mb", "mean_error_px"]
    runs = [("eofm", 48), ("eofm", 64), ("eofm preset", 48), ("tvl1", 48), ("dis", 48)]
    assert list(zip(table.tool, table["size"], strict=True)) == runs
    # OpenCV need not be installed.
    measured = table[table.tool != "dis"]
    assert (measured.seconds > 0).all()
    assert (measured.mean_error_px < 1).all()
    solver = pd.read_csv(folder / "solver.csv")
    columns = "size unknowns regulariser alpha image iterations seconds peak_mb"
    assert list(solver.columns) == columns.split()
    assert len(solver) == len(solver.drop_duplicates(columns.split()[:5])) == 16
    assert (solver.unknowns == 2 * solver["size"] ** 2).all()
    assert solver.iterations.between(2, 30).all()
    assert imread(folder / "benchmark.png").std() > 0.05
    assert (folder / "benchmark.pdf").read_bytes().startswith(b"%PDF")


def test_volume(project):
    folder = project.root / "results/volume"
    table = pd.read_csv(folder / "errors.csv")
    assert table.images.tolist() == 3 * ["bubbles"] + 3 * ["speckle"]
    assert table.method.tolist() == 2 * ["background", "test5", "preset"]
    assert read_field(folder / "speckle/preset/displacement.tif").shape == (3, 24, 28, 32)
    errors = table.set_index(["images", "method"]).e_rel
    assert errors["speckle", "preset"] < 0.7 * errors["speckle", "background"]
    assert {"e_rel_u3", "max_error_u3"} < set(table.columns)
    for images in ("bubbles", "speckle"):
        assert imread(folder / f"{images}.png").std() > 0.05
        assert (folder / f"{images}.pdf").read_bytes().startswith(b"%PDF")


def test_a_volume_in_tiles(project):
    folder = project.root / "results/samples/tiled"
    found = read_field(folder / "displacement.tif")
    errors = relative_errors(found, read_field(project.root / "results/volume/true.tif"))
    background = pd.read_csv(project.root / "results/volume/errors.csv").e_rel[0]
    assert errors["e_rel"] < 0.7 * background
    assert imread(folder / "strain.png").std() > 0.05
    table = pd.read_csv(project.root / "results/samples/summary.csv", index_col="sample")
    assert table.state.to_dict() == {
        "good": "done",
        "edge": "unusable",
        "missing": "unusable",
        "tiled": "done",
        "thin": "unusable",
    }
    assert 'data-sample="tiled"' in (project.root / "results/samples/index.html").read_text()


def test_benchmark_volume(project):
    table = pd.read_csv(project.root / "results/benchmark/volume.csv")
    columns = "tool size case seconds peak_mb mean_error_px rms_at_nodes_px coverage threads"
    assert list(table.columns) == columns.split()
    cases = table[table.tool == "eofm preset"].set_index("case")
    assert list(cases.index) == ["speckle", "affine", "noise", "sinusoid"]
    assert cases["size"].tolist() == [24, 48, 48, 48]
    assert (cases.seconds > 0).all()
    assert (cases.rms_at_nodes_px[["affine", "sinusoid"]] < 0.005).all()
    assert cases.coverage.between(0, 1).all()


def test_readings_are_ranked_by_their_distance_from_the_paper(project):
    table = pd.read_csv(project.root / "results/studies/readings.csv")
    cells = [f"{t}_{c}" for t in range(1, 6) for c in ("e_rel", "e_rel_u1", "e_rel_u2")]
    assert list(table.columns) == ["phantom", "reading", "seed", *cells, "log_rms"]
    paper = pd.read_csv(project.root / "results/table1.csv", dtype={"test": str})
    paper = paper.set_index("test").filter(like="paper_").loc[list("12345")].to_numpy().ravel()
    distance = np.sqrt((np.log(table[cells] / paper) ** 2).mean(axis=1))
    np.testing.assert_allclose(table.log_rms, distance, atol=1e-4)


@pytest.mark.parametrize(
    ("study", "columns"),
    [
        ("ensemble_table", "test cell paper median low high"),
        ("parameters", "bubbles alpha beta sigma e_rel"),
        ("theory", "part series x y refused"),
    ],
)
def test_studies(project, study, columns):
    folder = project.root / "results/studies"
    table = pd.read_csv(folder / f"{study}.csv")
    assert list(table.columns) == columns.split()
    assert len(table) > 1
    for name in (study, "demands", "fits"):
        assert imread(folder / f"{name}.png").std() > 0.02
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_ensemble(project):
    folder = project.root / "results/ensemble"
    table = pd.read_csv(folder / "test6.csv")
    ours, peers = ["test5", "preset_free", "preset", "test6"], ["elastix", "dis", "demons"]
    kind = ["phantom", "half", "renderer", "noise", "brightness", "inclusions", "cut"]
    judged = ["verdict", "dice", "modulus_error", "coverage", "coverage_modulus"]
    assert list(table.columns) == [*kind, "background", *ours, *peers, *judged]
    assert table.half.tolist() == ["tuned", "reported"]
    assert table.phantom.tolist() == [1, 2]
    assert table[ours].gt(0).all(axis=None)
    assert table[ours].lt(100).all(axis=None)
    judged = table[["dice", "coverage", "coverage_modulus"]]
    assert (judged.isna() | judged.ge(0) & judged.le(1)).all(axis=None)
    assert sorted(table.renderer) == ["speckle", "strained"]
    for number in (1, 2):
        errors = relative_errors(
            read_field(folder / f"{number}/test6.tif"), read_field(folder / f"{number}/true.tif")
        )
        assert errors["e_rel"] == pytest.approx(table.test6[number - 1], rel=1e-3)
    assert imread(folder / "ensemble.png").std() > 0.05
    assert (folder / "ensemble.pdf").read_bytes().startswith(b"%PDF")
