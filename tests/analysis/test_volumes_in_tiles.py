"""Volumes in tiles: what comes out is what the whole gives, and bad input ends in one line."""

import json
import math
import re
import shutil

import numpy as np
import pytest
import zarr
from matplotlib.image import imread

import eofm
from eofm import io
from eofm.analysis.gathered import write_gathered
from eofm.analysis.plan import Plan
from eofm.analysis.strain import strain
from eofm.analysis.tensors import invariants
from eofm.analysis.tiles import coarse, gather, tile
from eofm.app.cli import main
from eofm.compiled import use_threads
from eofm.errors import InputError
from eofm.io.formats import read_array
from eofm.settings import Estimation, Pair, Tiling

SHAPE = (64, 64, 64)
OVERLAP = 16
SIDES = {"lateral_size": 5.0, "axial_size": 4.0, "elevational_size": 5.0}


def moved(shape):
    z, y, x = np.mgrid[: shape[0], : shape[1], : shape[2]]
    u1 = 0.03 * (x - shape[2] / 2) + 0.3 * np.sin(y / 15)
    u2 = -0.04 * y + 0.3 * np.cos(x / 17)
    return np.stack([u1, u2, 0.02 * z + 0.2 * np.sin(x / 20)]).astype(np.float32)


def speckle(u, seed=1):
    count = int(u[0].size / 60)
    look = eofm.Phantom(count=count, sigma=(1.3, 1.6), brightness=(0.1, 1.0), noise=0.05, seed=seed)
    return eofm.make_phantom(u, look)[:2]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A volume, its whole estimate, and its tiles."""
    folder, u = tmp_path_factory.mktemp("tiles"), moved(SHAPE)
    I1, I2 = speckle(u)
    io.write_image(folder / "before.tif", I1, tuple(SIDES.values()))
    zarr.save_array(folder / "after.zarr", I2)
    known = eofm.Known(pixel_size=tuple(SIDES.values()))
    whole = eofm.estimate_displacement(I1, I2, known=known)
    pair = Pair(reference=folder / "before.tif", deformed=folder / "after.zarr")
    work = folder / "work"
    work.mkdir()
    said = coarse(pair, Estimation(), Tiling(tiles=(2, 2, 2), overlap=OVERLAP), work)
    assert said.startswith("level 0 is ready: tiles 0 to 7")
    for number in range(8):
        tile(work, 0, number)
    results = folder / "results"
    results.mkdir()
    trust = write_gathered(work, results)
    return folder, u, whole.u, trust, whole.deviation(16)


@pytest.mark.slow
def test_tiles_give_what_the_whole_gives(made):
    folder, u, whole, trust, _ = made
    found = io.read_field(folder / "results/displacement.tif")
    assert np.sqrt(((found - whole) ** 2).mean()) < 0.002
    assert np.sqrt(((found - u) ** 2).mean()) < 0.03
    assert trust.verdict == "good"


@pytest.mark.slow
def test_no_seam_stands_out_in_the_strain(made):
    folder, u, whole, *_ = made
    sides = tuple(SIDES.values())
    window = 3 * np.prod(sides) ** (1 / 3)
    e = np.moveaxis(read_array(folder / "results/strain.tif").values, 1, 0)
    found = io.read_field(folder / "results/displacement.tif")
    # The same as of the whole field, though it is made window by window.
    np.testing.assert_allclose(e, strain(found, sides, window), atol=2e-6)
    true, ours = strain(u, sides, window), ((e - strain(u, sides, window)) ** 2).sum(0)
    theirs = ((strain(whole, sides, window) - true) ** 2).sum(0)
    near = np.zeros(SHAPE, bool)
    for axis, n in enumerate(SHAPE):
        near[(slice(None),) * axis + (slice(n // 2 - 4, n // 2 + 4),)] = True
    inner = np.zeros(SHAPE, bool)
    inner[8:-8, 8:-8, 8:-8] = True
    seams, elsewhere = near & inner, ~near & inner
    assert np.sqrt(ours[seams].mean()) < 1.1 * np.sqrt(ours[elsewhere].mean())
    assert np.sqrt(ours[seams].mean()) < 1.02 * np.sqrt(theirs[seams].mean())


@pytest.mark.slow
def test_error_bars_are_those_of_the_whole(made):
    folder, *_, expected = made
    found = io.read_field(folder / "results/deviation.tif")
    # 16 draws tell a standard deviation to a sixth of itself, means over many voxels better.
    ratio = np.sqrt((found**2).mean(axis=(1, 2, 3)) / (expected**2).mean(axis=(1, 2, 3)))
    np.testing.assert_allclose(ratio, 1, atol=0.1)
    assert np.median(np.abs(np.log(found / expected))) < 0.25
    summary = json.loads((folder / "results/summary.json").read_text())
    assert summary["deviation_median_px"] == pytest.approx(np.median(found, (1, 2, 3)), rel=0.05)


@pytest.mark.slow
def test_paraview_gets_all_fields_of_tiles(made):
    folder, *_ = made
    results = folder / "results"
    head = (results / "results.vti").read_bytes().partition(b"<AppendedData")[0].decode()
    u = io.read_field(results / "displacement_um.tif")
    e = np.moveaxis(read_array(results / "strain.tif").values, 1, 0)
    expected = {"displacement [um]": u, "strain": e}
    expected |= invariants(e, "small") | {"match of the images": None, "first frame": None}
    bars = io.read_field(results / "deviation.tif")
    expected["standard deviation [um]"] = bars * np.reshape((5.0, 4.0, 5.0), (3, 1, 1, 1))
    found = re.findall(r'Name="([^"]*)" NumberOfComponents="(\d)".* offset="(\d+)"', head)
    assert {name for name, *_ in found} == set(expected)
    values = (results / "results.vti").read_bytes()[len(head) :].partition(b"_")[2]
    for name, count, offset in found:
        size = 4 * int(count) * math.prod(SHAPE)
        part = np.frombuffer(values, "<f4", size // 4, int(offset) + 8)
        if expected[name] is not None:
            part = np.moveaxis(part.reshape(*SHAPE, int(count)), -1, 0)
            np.testing.assert_allclose(part, expected[name].reshape(part.shape), atol=1e-5)


@pytest.mark.slow
def test_a_tile_has_the_same_bytes_for_any_number_of_threads(made, tmp_path):
    folder, *_ = made
    shutil.copytree(folder / "work", tmp_path / "work")
    use_threads(1)
    tile(tmp_path / "work", 0, 5)
    for kind in ("npy", "json"):
        name = f"work/tile_0_5.{kind}"
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


@pytest.mark.slow
def test_results_of_tiles(made):
    folder, _, _, trust, _ = made
    assert (trust.verdict, trust.pull, trust.flicker) == ("good", 0, 0)
    results = folder / "results"
    summary = json.loads((results / "summary.json").read_text())
    assert summary["tiles"] == [2, 2, 2]
    assert summary["size_px"] == list(SHAPE[::-1])
    assert summary["pixel_size_um"] == list(SIDES.values())
    assert summary["axial_strain_mean"] == pytest.approx(-0.04, abs=2e-3)
    um = io.read_field(results / "displacement_um.tif")
    px = io.read_field(results / "displacement.tif")
    np.testing.assert_allclose(um[1], 4 * px[1], rtol=1e-5)
    match = read_array(results / "trust.tif").values
    assert match.shape == SHAPE
    assert np.isfinite(match).mean() > 0.9
    assert np.nanmedian(match) > 0.8
    for name in ("pair", "displacement", "strain", "trust"):
        assert imread(results / f"{name}.png").std() > 0.05
    page = (results / "report.html").read_text()
    assert "good" in page
    assert "2 x 2 x 2 tiles" in page


def in_two_tiles(folder, I1, I2, estimation):
    """The verdict on two volumes that are estimated in two tiles."""
    files = [folder / "a.npy", folder / "b.npy"]
    for file, I in zip(files, (I1, I2), strict=True):
        np.save(file, I.astype(np.float32))
    pair = Pair(reference=files[0], deformed=files[1], error_bars=0, figures="none")
    coarse(pair, estimation, Tiling(tiles=(2, 1, 1), overlap=12), folder / "work")
    for number in (0, 1):
        tile(folder / "work", 0, number)
    return write_gathered(folder / "work", folder / "results")


@pytest.mark.slow
def test_tiles_say_what_the_whole_says_of_what_stands_still(tmp_path, rng):
    u = np.broadcast_to(np.reshape([0.5, 0.3, -0.4], (3, 1, 1, 1)), (3, 40, 48, 72))
    noise = 0.15 * rng.normal(size=u.shape[1:])
    images = [(I + noise).astype(np.float32) for I in speckle(u)]
    estimation = Estimation(denoising=0.0)
    whole = eofm.estimate_displacement(*images, estimation).trust
    tiles = in_two_tiles(tmp_path, *images, estimation)
    for trust in (whole, tiles):
        assert trust.pull > 0.05
        assert any("stands still" in reason for reason in trust.reasons)
    assert tiles.pull == pytest.approx(whole.pull, rel=0.3)
    assert tiles.spread == pytest.approx(whole.spread, rel=0.3)


@pytest.mark.slow
def test_tiles_say_that_slices_flicker(tmp_path, rng):
    u = np.broadcast_to(np.reshape([0.5, 0.3, -0.4], (3, 1, 1, 1)), (3, 40, 48, 72))
    images = (I * (1 + 0.2 * rng.normal(size=(40, 1, 1))) for I in speckle(u))
    trust = in_two_tiles(tmp_path, *images, Estimation())
    assert trust.flicker == 1
    assert any("slices flicker in 100% of the volume" in reason for reason in trust.reasons)


@pytest.mark.slow
def test_two_scales_in_tiles_and_faces_that_are_known(tmp_path, capsys):
    u = moved((24, 48, 96))
    u[1] -= u[1, :, :1]
    I1, I2 = speckle(u)
    np.save(tmp_path / "a.npy", I1)
    np.save(tmp_path / "b.npy", I2)
    work = tmp_path / "work"
    words = [f"--reference={tmp_path}/a.npy", f"--deformed={tmp_path}/b.npy", f"--work={work}"]
    words += ["--tiles", "3", "1", "1", "--overlap", "7", "--top", "moved 0.1 0 0.2"]
    assert main(["coarse", *words]) == 0
    assert "level 1 is ready" in capsys.readouterr().out
    assert main(["tile", str(work)]) == 1
    assert "level 0 is not prepared yet" in capsys.readouterr().err
    assert main(["gather", str(work), "--level=1"]) == 1
    assert "tiles 0, 1 of level 1 are missing" in capsys.readouterr().err
    for number in (0, 1):
        assert main(["tile", str(work), "--level=1", f"--number={number}"]) == 0
    assert main(["gather", str(work), "--level=1"]) == 0
    for number in (0, 1, 2):
        assert main(["tile", str(work), f"--number={number}"]) == 0
    results = tmp_path / "results"
    assert main(["gather", str(work), f"--folder={results}"]) == 0
    found = io.read_field(results / "displacement.tif")
    assert np.abs(found[:, :, 0] - np.reshape([0.1, 0.0, 0.2], (3, 1, 1))).max() < 1e-5
    inner = (slice(None), slice(4, -4), slice(12, -4), slice(4, -4))
    assert np.sqrt(((found - u)[inner] ** 2).mean()) < 0.05
    np.save(tmp_path / "a.npy", I2)
    assert main(["tile", str(work)]) == 1
    assert "changed after eofm coarse" in capsys.readouterr().err


BAD = {
    "frames": ({"reference": None, "deformed": None, "frames": "V.npy"}, "frames: is not done in"),
    "mask": ({"mask": "0,0 5,0 5,5"}, "mask: is not done in tiles"),
    "background": ({"background": "elastic", "top": "fixed"}, "background: is not done in tiles"),
    "stiffness": ({"stiffness": True}, "stiffness: is not done in tiles"),
    "paper": ({"method": "paper"}, "method: tiles want the preset"),
    "window": ({"local_window": 9}, "local_window: is not done in tiles"),
    "thin": ({"overlap": 20}, "less than twice the overlap of 20 px; use fewer"),
    "many": ({"tiles": (64, 64, 64), "overlap": 4}, "are too many for the 2 scales"),
    "image": ({"reference": "I.npy", "deformed": "I.npy"}, "tiles: are of volumes"),
    "sizes": ({"deformed": "W.npy"}, "has 24 x 32 x 40 px but"),
    "edge": ({"top": "glued"}, "top: cannot read 'glued'"),
    "unit": ({"top": "moved 0 1 0 um"}, "the size of a pixel is not known"),
    "strain": ({"strain_window": 900.0}, "strain_window: 900 um is wider"),
    "constant": ({"deformed": "C.npy"}, "is constant"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_tiles_cannot_do_ends_in_one_line(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    V = np.random.default_rng(0).random((24, 32, 48)).astype(np.float32)
    arrays = {"V": V, "W": V[..., :40], "I": V[0], "C": np.ones_like(V)}
    for key, values in arrays.items():
        np.save(f"{key}.npy", values)
    said, message = BAD[name]
    given = {"reference": "V.npy", "deformed": "V.npy", "tiles": (2, 1, 1), "overlap": 8} | said
    sections = [
        section.parse({k: v for k, v in given.items() if k in section.model_fields}, "")
        for section in (Pair, Estimation, Tiling)
    ]
    (tmp_path / "work").mkdir()
    with pytest.raises(InputError, match=message) as caught:
        coarse(*sections, tmp_path / "work")
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "work").iterdir())


def test_a_folder_without_a_plan(tmp_path):
    for step in (lambda: tile(tmp_path, 0, 0), lambda: gather(tmp_path, 1)):
        with pytest.raises(InputError, match="make it by eofm coarse first"):
            step()
    with pytest.raises(InputError, match="make it by eofm coarse first"):
        Plan.read(tmp_path / "plan.json")
