"""Every step from the command line: that it works, and how it fails."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import tifffile
from scipy import ndimage
from test_io import KINDS, written

import eofm
from eofm import io
from eofm.app.cli import STEPS, main, parser


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the results of all steps on a small sample."""
    folder = tmp_path_factory.mktemp("steps")
    sample = ["--height", "40", "--width", "60", "--compression", "2"]
    disc = ["--inclusions", '{"x1": 30, "x2": 22, "radius": 9, "stiffness": 5}']
    f = {name: str(folder / name) for name in FILES}
    for words in (
        ["forward", "--output", f["true.tif"], *sample, *disc],
        ["background", "--output", f["bg.tif"], *sample],
        ["phantom", f["true.tif"], "--reference", f["a.tif"], "--deformed", f["b.tif"]]
        + ["--table", f["true.csv"], "--count", "150", "--sigma", "1.5", "2"],
        [
            "track",
            f["a.tif"],
            f["b.tif"],
            "--prediction",
            f["bg.tif"],
            "--output",
            f["bubbles.csv"],
        ],
        ["estimate", f["a.tif"], f["b.tif"], "--bubbles", f["bubbles.csv"], "--output", f["u.tif"]]
        + ["--background", f["bg.tif"], "--scales", "3", "--zero-edges", "top", "bottom"],
        ["evaluate", f["u.tif"], f["true.tif"], "--output", f["errors.csv"]],
    ):
        assert main(words) == 0, words
    return folder


FILES = ["true.tif", "bg.tif", "a.tif", "b.tif", "true.csv", "bubbles.csv", "u.tif", "errors.csv"]


def fails(capsys, words, *parts):
    """Run a step that must fail with one line, which holds some parts."""
    assert main([str(word) for word in words]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"eofm {words[0]}: ")
    for part in parts:
        assert str(part) in error


def test_all_steps_write_their_files(folder):
    tables = [f"{name}.sha256" for name in FILES if name.endswith(".csv")]
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES + tables)
    assert io.read_field(folder / "u.tif").shape == (2, 40, 60)
    assert pd.read_csv(folder / "errors.csv").e_rel[0] < 30


def test_steps_are_the_library_s_functions(folder):
    import eofm

    I1, I2 = io.read_pair(folder / "a.tif", folder / "b.tif")
    u = eofm.estimate_displacement(
        I1,
        I2,
        eofm.Estimation(scales=3, zero_edges=("top", "bottom")),
        known=eofm.Known(
            bubbles=io.read_bubbles(folder / "bubbles.csv"),
            background=io.read_field(folder / "bg.tif"),
        ),
    ).u
    np.testing.assert_array_equal(u.astype(np.float32), tifffile.imread(folder / "u.tif"))


@pytest.mark.parametrize("step", [step.__name__.replace("_", "-") for step in STEPS])
def test_help_teaches_each_step(step, capsys):
    with pytest.raises(SystemExit, match="0"):
        main([step, "--help"])
    text = capsys.readouterr().out
    assert f"eofm {step} " in text.partition("options:")[0].partition("\n\n")[2]
    assert "px" in text
    assert "--plane VALUE" not in text


@pytest.mark.parametrize(
    "words", [[], ["etimate"], ["track", "a.tif"], ["track", "a", "b", "--gat", "2"]]
)
def test_wrong_usage_is_status_two(words):
    with pytest.raises(SystemExit, match="2"):
        main(words)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["a", "b", "--output", "u", "--alhpa", "3"], "--alhpa; did you mean --alpha?"),
        (["a", "b", "--ouput=u"], "--ouput; did you mean --output?"),
        (["a", "b", "out", "--zero_edges", "top"], "--zero_edges; did you mean --zero-edges?"),
        (["a", "b", "--output", "u", "--qqq"], "--qqq; --help names those that there are"),
    ],
)
def test_a_misspelt_option_is_named_with_what_it_may_have_been(capsys, words, said):
    with pytest.raises(SystemExit, match="2"):
        main(["estimate", *words])
    assert capsys.readouterr().err.endswith(f"\neofm estimate: error: unknown option {said}\n")


def test_options_may_be_shortened_and_values_have_dashes():
    words = ["estimate", "--out", "u.tif", "--alph=2", "--bubbles=--x", "--", "a.tif", "--b.tif"]
    given = parser().parse_args(words)
    assert (given.alpha, str(given.bubbles), str(given.deformed)) == (2, "--x", "--b.tif")


@pytest.mark.parametrize("step", ["track", "estimate"])
@pytest.mark.parametrize("kind", KINDS)
def test_unusable_images(folder, tmp_path, capsys, step, kind):
    path, _ = written(tmp_path, kind)
    fails(capsys, [step, folder / "a.tif", path, "--output", tmp_path / "out"], path)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("step", ["track", "estimate"])
def test_two_sizes_and_constant_images(folder, tmp_path, capsys, step):
    other = tmp_path / "other.tif"
    tifffile.imwrite(other, np.eye(40, 61, dtype=np.float32))
    fails(capsys, [step, folder / "a.tif", other, "--output", tmp_path / "o"], "40 x 61", "40 x 60")
    tifffile.imwrite(other, np.full((40, 60), 7, np.uint8))
    fails(capsys, [step, folder / "a.tif", other, "--output", tmp_path / "o"], "constant")


def test_too_small_for_the_scales(tmp_path, capsys):
    small = tmp_path / "small.tif"
    tifffile.imwrite(small, np.eye(9, 12))
    words = ["estimate", small, small, "--output", tmp_path / "o", "--method", "paper"]
    fails(capsys, words, "too small for 4 scales; use at most 1")


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["estimate", "--alpha", "-1"], "alpha: input should be greater than or equal to 0.000001"),
        (["estimate", "--alpha", "x"], "alpha: input should be a valid number"),
        (["estimate", "--zero-edges", "up"], "zero_edges.0: input should be 'top'"),
        (["estimate", "--limits", "1"], "limits"),
        (["track", "--quality", "2"], "quality: input should be less than 1"),
    ],
)
def test_values_out_of_range(folder, tmp_path, capsys, words, part):
    step, *rest = words
    fails(
        capsys, [step, folder / "a.tif", folder / "b.tif", "--output", tmp_path / "o", *rest], part
    )


def test_unusable_fields_and_tables(folder, tmp_path, capsys):
    pair, out = [folder / "a.tif", folder / "b.tif"], ["--output", tmp_path / "o"]
    fails(
        capsys, ["estimate", *pair, *out, "--background", folder / "a.tif"], "no displacement field"
    )
    fails(
        capsys, ["estimate", *pair, *out, "--bubbles", folder / "errors.csv"], "lacks the column x1"
    )
    fails(capsys, ["estimate", *pair, *out, "--bubbles", folder / "none.csv"], "none.csv")
    fails(capsys, ["track", *pair, *out, "--prediction", folder / "a.tif"], "no displacement field")
    fails(capsys, ["evaluate", folder / "a.tif", folder / "u.tif", *out], "no displacement field")
    fails(
        capsys, ["phantom", folder / "a.tif", "--reference", "r", "--deformed", "d", "--table", "t"]
    )
    size = ["--height", "40", "--width", "60"]
    fails(capsys, ["forward", "--output", tmp_path / "none" / "u.tif", *size], "does not exist")
    fails(
        capsys,
        ["background", *out, "--height", "40", "--width", "60", "--poisson-ratio", "0.5"],
        "less than 0.5",
    )
    fails(capsys, ["background", *out, "--height", "40"], "sample: width: field required")


def test_all_outputs_are_checked_before_any_work(folder, tmp_path, capsys):
    pair = [folder / "a.tif", folder / "b.tif"]
    out = tmp_path / "u.tif"
    missing = tmp_path / "no" / "sd.tif"
    fails(capsys, ["estimate", *pair, "--output", out, "--deviation", missing], "sd")
    fails(capsys, ["estimate", *pair, "--output", out, "--deviation", out], "two results")
    fails(capsys, ["estimate", *pair, "--output", tmp_path], "is a folder")
    assert not list(tmp_path.iterdir())


def test_error_bars_and_stiffness_as_their_help_says(folder, tmp_path, capsys):
    pair = [str(folder / "a.tif"), str(folder / "b.tif")]
    out = [str(tmp_path / name) for name in ("E.tif", "u.tif", "sd.tif", "sd_E.tif")]
    assert main(["estimate", *pair, "--output", out[1], "--deviation", out[2]]) == 0
    assert tifffile.imread(out[2]).min() > 0
    words = ["stiffness", *pair, "--output", out[0], "--displacement", out[1]]
    words += ["--height", "40", "--width", "60", "--compression", "2"]
    assert main([*words, "--deviation", out[2], "--stiffness-deviation", out[3]]) == 0
    assert "of the background's; gamma" in capsys.readouterr().out
    E = tifffile.imread(out[0])
    x2, x1 = np.mgrid[:40, :60]
    disc = (x1 - 30) ** 2 + (x2 - 22) ** 2 < 9**2
    assert E[disc].mean() > 1.1 * E[~disc].mean()
    assert np.median(E) == pytest.approx(1, abs=0.05)
    assert tifffile.imread(out[3]).shape == E.shape


def test_none_is_said_as_help_says_it(folder, tmp_path):
    words = ["estimate", str(folder / "a.tif"), str(folder / "b.tif")]
    words += ["--output", str(tmp_path / "u.tif"), "--scales", "none"]
    assert main([*words, "--alpha", "none", "--limits", "none", "--zero-edges", "none"]) == 0


def test_no_bubble_found(folder, tmp_path, capsys):
    words = ["track", folder / "a.tif", folder / "b.tif", "--output", tmp_path / "bubbles.csv"]
    fails(capsys, [*words, "--min-area", "399"], "no bubble found")
    assert not (tmp_path / "bubbles.csv").exists()


def test_an_estimate_without_bubbles_does_not_wait_for_pandas():
    code = "import sys, eofm.app.cli, eofm.flow.estimate; sys.exit('pandas' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_an_estimate_that_must_not_be_trusted_says_so(folder, tmp_path, capsys):
    """Images that have nothing in common: there is a result, a reason, and status 3."""
    other = tmp_path / "other.tif"
    tifffile.imwrite(other, io.read_image(folder / "b.tif")[::-1, ::-1].astype(np.float32))
    words = ["estimate", folder / "a.tif", other, "--output", tmp_path / "u.tif"]
    assert main([str(word) for word in words]) == 3
    assert capsys.readouterr().err.startswith("eofm estimate: failed: only ")
    assert (tmp_path / "u.tif").exists()


def test_linear_intensity_is_said_once_and_changes_nothing(tmp_path, capsys):
    """Speckle that fades by 25 dB: one line of `estimate` and `sample`, none of the logarithm."""
    rng = np.random.default_rng(3)
    wave = ndimage.gaussian_filter(rng.normal(size=(2, 72, 96)), (0, 1.2, 1.2))
    I = np.hypot(*wave) * 10 ** (-1.25 * np.linspace(0, 1, 72))[:, None]
    pair = [tmp_path / "a.tif", tmp_path / "b.tif"]
    for path, image in zip(pair, (I, np.roll(I, 1, axis=1)), strict=True):
        tifffile.imwrite(path, image.astype(np.float32))
    assert main(["estimate", *map(str, pair), "--output", str(tmp_path / "u.tif")]) == 0
    assert capsys.readouterr().err.count("linear intensity") == 1
    u = eofm.estimate_displacement(*(io.read_image(path) for path in pair)).u
    np.testing.assert_array_equal(io.read_field(tmp_path / "u.tif"), u.astype(np.float32))
    words = ["sample", "--reference", str(pair[0]), "--deformed", str(pair[1]), "--error-bars", "0"]
    words += ["--figures", "none", "--folder", str(tmp_path / "mine")]
    for intensity, count in {"linear": 1, "log": 0}.items():
        main([*words, "--intensity", intensity])
        assert capsys.readouterr().err.count("linear intensity") == count
        text = (tmp_path / "mine/report.html").read_text()
        assert text.count("linear intensity") == count
