"""The page and the layers of a small sample, and of a small volume."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
import tifffile

import eofm
from eofm import io
from eofm.analysis.layers import layers
from eofm.analysis.page import page
from eofm.app.cli import main
from eofm.settings import WARPING, Estimation

pytestmark = pytest.mark.slow

QUICK = Estimation(method="paper", scales=3, limits=(0, 1), **WARPING)


@pytest.fixture(scope="module")
def results(pair):
    """A pair whose middle is a dead zone."""
    dead = np.zeros(pair[0].shape, bool)
    dead[25:30, 40:50] = True
    known = eofm.Known(dead=dead, pixel_size=(4.0, 2.0))
    return eofm.analyse(*pair[:2], known=known, estimation=QUICK)


@pytest.fixture(scope="module")
def written(results, tmp_path_factory):
    folder = tmp_path_factory.mktemp("written")
    results.write(folder, ["before <1>.tif", "after.tif"])
    return folder


class Reader(HTMLParser):
    """Whether tags are closed in order, and what a page asks for."""

    def __init__(self):
        super().__init__()
        self.open, self.wants = [], []

    def handle_starttag(self, tag, attrs):
        self.wants += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img", "input", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag != "path":
            assert self.open.pop() == tag


def test_the_page_is_whole_and_needs_nothing_else(written):
    text = (written / "report.html").read_text()
    reader = Reader()
    reader.feed(text.replace("<path ", "<path2 ").replace("/></svg>", "></path2></svg>"))
    assert not reader.open
    assert reader.wants
    assert all(address.startswith("data:image/png;base64,") for address in reader.wants)
    assert not re.search(r"https?:|url\(|@import", text)
    assert len(text) < 600_000


def test_the_page_says_what_the_summary_says(written, results):
    text = (written / "report.html").read_text()
    summary = json.loads((written / "summary.json").read_text())
    assert f">{results.trust.verdict}</span>" in text
    assert "before &lt;1&gt;.tif" in text
    far = max(summary["u2_range_um"], key=abs)
    assert f"{abs(far):.3g} µm" in text
    for title in ("axial u2", "error bar of u2", "e22 axial", "maximum shear", "what decides"):
        assert f'alt="{title}"' in text
    assert 'class="before pixels"' in text
    assert 'class="after pixels"' in text
    assert "The mask leaves out 1% of the image." in text
    assert "small values, below 1 % too, are normal" in text


def test_the_same_results_have_the_same_page(results):
    assert page(results, "a & b") == page(results, "a & b")
    assert "<title>a &amp; b</title>" in page(results, "a & b")


def test_new_files_hold_what_they_say(written, results):
    images = tifffile.imread(written / "images.tif")
    np.testing.assert_array_equal(images, np.float32([results.first, results.last]))
    values = tifffile.imread(written / "strain_invariants.tif")
    with tifffile.TiffFile(written / "strain_invariants.tif") as file:
        names = file.imagej_metadata["Labels"]
    assert names == ["principal 1", "principal 2", "change of area in the plane", "maximum shear"]
    live = ~results.dead
    np.testing.assert_allclose(values[2][live], results.strain[:2].sum(0)[live], rtol=1e-5)
    np.testing.assert_allclose(values[3], (values[0] - values[1]) / 2, rtol=1e-4, atol=1e-7)
    assert np.isnan(values[:, results.dead]).all()


def test_paraview_has_all_fields_on_the_grid_of_the_image(written, results):
    data = (written / "results.vti").read_bytes()
    head, _, values = data.partition(b'<AppendedData encoding="raw">\n_')
    text = head.decode()
    assert 'Spacing="4.0 2.0 1.0"' in text
    fields = dict(re.findall(r'Name="([^"]+)" NumberOfComponents="\d"[^>]*offset="(\d+)"', text))
    assert {"first frame", "strain", "principal 1", "maximum shear", "share of the images"} <= (
        fields.keys()
    )
    start = int(fields["displacement [um]"]) + 8
    count = 3 * results.first.size
    u = np.frombuffer(values, "<f4", count, start).reshape(*results.first.shape, 3)
    expected = results.u * np.reshape([4.0, 2.0], (2, 1, 1))
    live = ~results.dead
    np.testing.assert_allclose(u[live][:, :2], expected[:, live].T, rtol=1e-5, atol=1e-6)
    assert np.isnan(u[~live][:, :2]).all()
    assert 'ComponentName1="e22 axial"' in text


def test_layers_are_the_results_in_true_lengths(written, results):
    found = {more["name"]: (data, more, kind) for data, more, kind in layers(written)}
    assert all(more["scale"] == [2.0, 4.0] for _, more, _ in found.values())
    axial = found["u2 axial [um]"][0]
    np.testing.assert_allclose(axial[~results.dead], 2 * results.u[1][~results.dead], rtol=1e-5)
    np.testing.assert_allclose(
        found["error bar of u1 [um]"][0],
        4 * np.where(results.dead, np.nan, results.deviation[0]),
        rtol=1e-5,
    )
    vectors, _, kind = found["displacement"]
    assert kind == "vectors"
    for at, way in vectors[::17]:
        row, column = at.astype(int)
        np.testing.assert_allclose(way, results.u[::-1, row, column], rtol=1e-5)
        assert not results.dead[row, column]
    bubbles = results.steps[0].bubbles
    np.testing.assert_allclose(found["bubbles"][0], bubbles[["x2", "x1"]], atol=1e-6)
    assert [k for k in found if k.startswith("e")][:1] == ["error bar of u1 [um]"]


def test_napari_takes_the_layers(written):
    """Without a window."""
    napari = pytest.importorskip("napari.layers", reason="the extra view is not installed")
    for layer in layers(written):
        made = napari.Layer.create(*layer)
        assert made.ndim == 2
        np.testing.assert_allclose(made.scale, [2.0, 4.0])


def test_what_is_no_result_is_said_in_one_line(tmp_path, capsys):
    assert main(["view", str(tmp_path / "nowhere")]) == 1
    assert main(["view", str(tmp_path)]) == 1
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 2
    assert told[0].endswith("nowhere: is no folder")
    assert told[1].endswith("holds no complete results; make them with eofm sample")


@pytest.fixture(scope="module")
def volume(tmp_path_factory):
    """A stretched and pressed volume of voxels that are no cubes, from files."""
    folder = tmp_path_factory.mktemp("volume")
    z, y, x = np.mgrid[:24, :32, :40].astype(float)
    u = np.stack([0.02 * (x - 20), -0.04 * y, 0.015 * (z - 12)])
    pair = eofm.make_phantom(u, eofm.Phantom(count=420, seed=3, sigma=(1.3, 1.6)))
    for name, V in zip("ab", pair[:2], strict=True):
        io.write_image(folder / f"{name}.tif", V, (5, 5, 8))
    words = ["sample", "--reference", folder / "a.tif", "--deformed", folder / "b.tif"]
    words += ["--folder", folder / "results", "--error-bars", 4, "--background", "elastic"]
    words += ["--top", "fixed", "--bottom", "moved 0 -6.2 0 um", "--poisson-ratio", 0.4]
    words += ["--strain-measure", "hencky", "--roi", "0 0 3 40 32 21"]
    assert main([str(word) for word in words]) == 0
    return folder / "results", u[:, 3:]


def test_a_volume_from_files_has_all_results(volume):
    folder, u = volume
    found = io.read_field(folder / "displacement.tif")
    assert found.shape == (3, 21, 32, 40)
    inner = np.s_[:, 3:-3, 4:-4, 4:-4]
    assert np.abs(found - u)[inner].mean() < 0.05
    e = np.moveaxis(tifffile.imread(folder / "strain.tif"), 1, 0)
    assert e.shape == (6, 21, 32, 40)
    np.testing.assert_allclose(e[1][3:-3, 4:-4, 4:-4].mean(), np.log(0.96), atol=3e-3)
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["size_px"] == [40, 32, 21]
    assert summary["pixel_size_um"] == [5.0, 5.0, 8.0]
    assert list(summary["strains"])[2] == "e33 elevational"
    assert summary["strain_measure"] == "hencky"
    assert len(summary["u3_range_um"]) == 2
    assert set(pd.read_csv(folder / "bubbles.csv")) >= {"x3", "u3"}
    for name in ("pair", "displacement", "strain", "quality"):
        assert (folder / f"{name}.png").stat().st_size > 10_000
    text = (folder / "report.html").read_text()
    assert 'alt="elevational u3"' in text
    assert "change of volume" in text
    assert len([kind for *_, kind in layers(folder) if kind == "image"]) == 15


def test_what_volumes_have_not_is_said_in_one_line(volume, tmp_path, capsys):
    folder, pair = volume[0].parent, ["--reference", "a.tif", "--deformed", "b.tif"]
    pair = [str(folder / word) if word.endswith("tif") else word for word in pair]
    for words, text in (
        (["--stiffness", "true"], "stiffness: is identified of images only, not of volumes"),
        (["--roi", "0 0 60 32"], "outside of the volume of 40 x 32 x 24 px"),
        (["--top", "moved 0 -2"], "top: cannot read 'moved 0 -2'"),
    ):
        assert main(["sample", *pair, "--folder", str(tmp_path / "o"), *words]) == 1
        assert text in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "o").exists()
