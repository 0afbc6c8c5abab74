"""Scenes and their analysis: what is described is what is used."""

import json

import h5py
import numpy as np
import pandas as pd
import pressed
import pytest
import tifffile
from scipy.io import savemat

import eofm
from eofm.analysis.report import check_results
from eofm.analysis.scene import read_scene
from eofm.imaging.splines import evaluate, evaluate_field, resize
from eofm.settings import WARPING, Estimation, Pair, Tracking

pytestmark = pytest.mark.slow

QUICK = Estimation(method="paper", scales=3, limits=(0, 1), **WARPING)


@pytest.fixture
def files(tmp_path, pair, truth):
    """The small phantom as files, in a folder of its own."""
    for name, I in zip(("before", "after"), pair[:2], strict=True):
        tifffile.imwrite(tmp_path / f"{name}.tif", I.astype(np.float32))
    return tmp_path


def describe(files, **more):
    return Pair(reference=str(files / "before.tif"), deformed=str(files / "after.tif"), **more)


def analyse(pair, **settings):
    scene = read_scene(pair)
    known = {"known": scene.known, "sample": scene.sample, "measures": pair}
    return eofm.analyse(*scene.frames, **known, **settings)


def error(u, truth):
    return eofm.relative_errors(u, truth)["e_rel"]


def test_known_edges_and_background_bring_the_field_nearer(files, truth):
    free = analyse(describe(files), estimation=QUICK)
    edges = {"top": "fixed", "bottom": "moved 0 -2.5"}
    held = analyse(describe(files, **edges), estimation=QUICK)
    full = analyse(
        describe(files, **edges, background="elastic", poisson_ratio=0.48), estimation=QUICK
    )
    np.testing.assert_allclose(held.u[:, 0], 0, atol=1e-9)
    np.testing.assert_allclose(held.u[1, -1], -2.5, atol=1e-9)
    assert error(full.u, truth) < error(held.u, truth) < error(free.u, truth)


def test_edges_work_with_any_background_and_hard_or_weak(files, truth):
    edges = {"top": "fixed", "bottom": "moved 0 -2.5"}
    weak = analyse(describe(files, **edges), estimation=QUICK.changed(edge_weight=50))
    hard = analyse(describe(files, **edges), estimation=QUICK)
    assert 1e-6 < abs(weak.u[:, 0]).max() < 0.2
    assert np.linalg.norm(weak.u - hard.u) < 0.05 * np.linalg.norm(truth)


def test_a_region_inside_the_sample(files, truth, sample):
    """A cut-out whose background is that of the whole sample."""
    pair = describe(
        files,
        roi=(10, 8, 60, 44),
        extent=(0, 0, sample.width, sample.height),
        top="outside fixed",
        bottom="outside moved 0 -2.5",
        left="outside",
        right="outside",
        background="elastic",
        poisson_ratio=0.48,
    )
    scene = read_scene(pair)
    assert not scene.known.edges
    whole = eofm.background_field(sample, eofm.Forward(background_error=1e-4))
    np.testing.assert_allclose(scene.known.background, whole[:, 8:52, 10:70], atol=0.01)
    seen = truth[:, 8:52, 10:70]
    assert error(analyse(pair, estimation=QUICK).u, seen) < 0.7 * error(
        scene.known.background, seen
    )


def test_pixels_that_are_not_square(files, pair, truth):
    """The same sample imaged with half the lateral resolution."""
    half = (61, 45)
    for name, I in zip(("before", "after"), pair[:2], strict=True):
        tifffile.imwrite(files / f"{name}.tif", resize(I, half).astype(np.float32))
    ratio = 89 / 44
    known = describe(files, lateral_size=ratio, axial_size=1.0)
    u = analyse(known, tracking=Tracking(gate=3), estimation=QUICK).u
    expected = np.stack([resize(c, half) for c in truth])
    expected[0] /= ratio
    assert error(u, expected) < 35


def test_dead_zones_carry_no_data(files, pair):
    spoilt = pair[0].copy()
    spoilt[20:40, 30:60] = np.random.default_rng(1).uniform(0, 1, (20, 30))
    tifffile.imwrite(files / "before.tif", spoilt.astype(np.float32))
    mask = np.zeros(spoilt.shape, np.uint8)
    mask[19:41, 29:61] = 255
    tifffile.imwrite(files / "mask.tif", mask)
    edges = {"top": "fixed", "bottom": "moved 0 -2.5", "background": "elastic"}
    with_mask = describe(files, mask=str(files / "mask.tif"), **edges)
    polygon = describe(files, mask="28.5,18.5 60.5,18.5 60.5,40.5 28.5,40.5", **edges)
    assert (read_scene(with_mask).known.dead == read_scene(polygon).known.dead).mean() > 0.98
    clean = analyse(with_mask, estimation=QUICK)
    bubbles = clean.steps[0].bubbles
    assert not ((bubbles.x1.between(30, 59)) & (bubbles.x2.between(20, 39))).any()
    assert clean.summary["share_of_data_median"] == np.median(clean.share[~clean.dead])
    seen = clean.u[1, ~clean.dead]
    assert clean.summary["u2_range_px"] == [seen.min(), seen.max()]
    spoilt = analyse(describe(files, **edges), estimation=QUICK)
    assert clean.summary["residual_rms"] < spoilt.summary["residual_rms"]


def test_what_a_mask_hides_does_not_stretch_the_grey_scale(files, pair, truth):
    """A saturated reflection under the mask changes nothing elsewhere."""
    mask = np.zeros(truth.shape[1:], np.uint8)
    mask[:2] = 1
    tifffile.imwrite(files / "mask.tif", mask)
    found = []
    for value in (0, 50):
        for name, I in zip(("before", "after"), pair[:2], strict=True):
            spoilt = I.copy()
            spoilt[:2] = value
            tifffile.imwrite(files / f"{name}.tif", spoilt.astype(np.float32))
        more = {"mask": str(files / "mask.tif")}
        found.append(
            analyse(describe(files, **more), estimation=Estimation(method="paper", scales=3)).u
        )
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)


def test_a_profile_belongs_to_the_edge_of_the_whole_sample(files, sample):
    """The region's background has the profile where the region is."""
    profile = pd.DataFrame({"u1": 0.0, "u2": np.linspace(0, -3, sample.width)}, index=range(90))
    profile.to_csv(files / "bottom.csv", index=False)
    pair = describe(
        files,
        roi=(20, 5, 30, 56),
        extent=(0, 5, sample.width, 56),
        top="fixed",
        bottom=f"moved {files / 'bottom.csv'}",
        background="elastic",
    )
    scene = read_scene(pair)
    np.testing.assert_allclose(scene.known.edges["bottom"][1], profile.u2[20:50])
    np.testing.assert_allclose(scene.known.background[1, -1], profile.u2[20:50], atol=1e-3)


def test_a_sequence_adds_up(files, truth):
    """Three frames: the motion from the first to the last is the sum along the way."""
    half = truth / 2
    I1, I2, bubbles = eofm.make_phantom(half, eofm.Phantom(count=90, seed=3))
    frames = [I1, I2]
    # The third frame: every bubble moved by the whole field.
    frames.append(eofm.make_phantom(truth, eofm.Phantom(count=90, seed=3))[1])
    tifffile.imwrite(
        files / "frames.tif", np.stack(frames).astype(np.float32), photometric="minisblack"
    )
    edges = {"top": "fixed", "bottom": "moved 0 -1.25", "background": "elastic"}
    result = analyse(Pair(frames=str(files / "frames.tif"), **edges), estimation=QUICK)
    assert len(result.steps) == 2
    x = bubbles[["x1", "x2"]].to_numpy().T
    assert error(result.u, truth) < 15
    found = evaluate_field(result.u, x) - evaluate_field(truth, x)
    assert np.sqrt((found**2).mean()) < 0.25
    np.testing.assert_allclose(result.u[:, 0], 0, atol=1e-9)
    result.write(files)
    # Steps count from 1, as in what is said of them.
    with tifffile.TiffFile(files / "increments.tif") as file:
        assert file.asarray().shape == (4, *truth.shape[1:])
        steps = [label.partition(":")[0] for label in file.imagej_metadata["Labels"]]
    assert steps == ["step 1", "step 1", "step 2", "step 2"]
    assert set(pd.read_csv(files / "bubbles.csv").step) == {1, 2}


def test_the_step_of_a_sequence_that_fails_is_named(truth):
    steps = ((truth / 2, 3), (truth, 3), (truth, 8))
    I1 = eofm.make_phantom(truth, eofm.Phantom(count=90, seed=3))[0]
    frames = [eofm.make_phantom(u, eofm.Phantom(count=90, seed=seed))[1] for u, seed in steps]
    alone = Pair(error_bars=0, reference="a", deformed="b")
    result = eofm.analyse(I1, *frames, measures=alone, estimation=QUICK)
    assert [step.trust.verdict for step in result.steps] == ["good", "good", "failed"]
    assert result.trust.verdict == "failed"
    (reason,) = result.trust.reasons
    assert reason.startswith("step 3 of 3 (frames 3 and 4): only ")


def test_what_shows_something_else_has_failed_though_no_bubble_can_be_followed(pair, rng):
    I1, I2, _ = pair
    other = rng.random(I1.shape)
    measures = Pair(error_bars=0, reference="a", deformed="b")
    found = eofm.analyse(I1, I2, other, measures=measures, estimation=QUICK)
    assert found.steps[0].trust.verdict != "failed"
    assert found.trust.verdict == "failed"
    (reason,) = found.trust.reasons
    assert "(frames 2 and 3)" in reason
    assert "check that both show the same sample" in reason
    assert found.summary["bubbles"][1] == 0
    assert len(found.steps[0].bubbles) > 0


def test_a_field_is_found_where_no_bubble_can_be_followed(pair, truth, tmp_path):
    I1, I2, _ = pair
    measures = Pair(error_bars=0, reference="a", deformed="b", figures="png")
    strict = Tracking(quality=0.9999999)
    found = eofm.analyse(I1, I2, measures=measures, tracking=strict)
    assert found.summary["bubbles"] == [0]
    assert np.abs(found.u - truth).mean() < 0.1
    found.write(tmp_path)
    assert "None of" in (tmp_path / "report.html").read_text()
    assert pd.read_csv(tmp_path / "bubbles.csv").empty


def test_brightness_that_changes_from_place_to_place(rng):
    from conftest import speckle

    I = speckle((64, 80), rng, 2.0)
    x1 = np.mgrid[:64, :80][1]
    shaded = I * (1 - 0.6 * x1 / 79) + 0.2 * x1 / 79
    plain, local = (
        eofm.estimate_displacement(
            I, shaded, Estimation(method="paper", alpha=0.02, warps=3, local_window=w, **WARPING)
        ).u
        for w in (None, 8.0)
    )
    assert np.hypot(*local).mean() < 0.3 * np.hypot(*plain).mean()


def test_bubbles_near_edges_of_unknown_motion_can_weigh_more(files, truth):
    def border(u):
        return abs(u - truth)[:, :, [*range(4), *range(-4, 0)]].mean()

    results = [
        analyse(describe(files), estimation=QUICK.changed(edge_bubbles=w)).u for w in (1.0, 5.0)
    ]
    assert border(results[1]) < border(results[0])


def test_everything_is_written(files, truth):
    pair = describe(files, lateral_size=4.0, axial_size=2.0)
    analyse(pair, estimation=QUICK).write(files)
    u = tifffile.imread(files / "displacement.tif")
    np.testing.assert_allclose(
        tifffile.imread(files / "displacement_um.tif"), u * [[[4]], [[2]]], rtol=1e-6
    )
    assert tifffile.imread(files / "strain.tif").shape == (3, *truth.shape[1:])
    summary = json.loads((files / "summary.json").read_text())
    assert summary["size_px"] == [90, 61]
    assert summary["strain_window_um"] == pytest.approx(3 * np.sqrt(8))
    assert summary["residual_rms"] < summary["residual_rms_without_motion"]
    assert set(pd.read_csv(files / "bubbles.csv")) >= {"x1", "x2", "u1", "u2", "step"}
    for name in ("pair", "displacement", "strain", "quality"):
        assert (files / f"{name}.png").stat().st_size > 10_000
        assert (files / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_images_of_all_kinds(tmp_path, pair):
    from skimage.io import imsave

    I = (255 * pair[0] / pair[0].max()).astype(np.uint8)
    tifffile.imwrite(tmp_path / "stack.tif", np.stack([0 * I, I, I]), photometric="minisblack")
    imsave(tmp_path / "I.png", I)
    np.save(tmp_path / "I.npy", I)
    np.savez(tmp_path / "I.npz", I=I, other=I[:5])
    savemat(tmp_path / "old.mat", {"before": I, "after": I})
    savemat(tmp_path / "one.mat", {"before": I})
    with h5py.File(tmp_path / "new.mat", "w") as file:
        file["before"] = I.T
    names = ["stack.tif#1", "I.png", "I.npy", "I.npz#I", "old.mat#after", "one.mat", "new.mat"]
    for name in names:
        read = eofm.io.read_image(tmp_path / name)
        np.testing.assert_array_equal(read, I, err_msg=name)


def test_log_intensity(files, pair):
    linear = pair[0] + 0.01
    tifffile.imwrite(files / "before.tif", linear.astype(np.float32))
    frames = read_scene(describe(files, intensity="log")).frames
    np.testing.assert_allclose(frames[0], np.log(linear), atol=1e-5)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"roi": (50, 0, 60, 40)}, "roi: reaches from .50, 0. to .110, 40., outside of the image"),
        ({"mask": "0,0 200,0 200,200 0,200"}, "mask: leaves no pixel"),
        ({"mask": "1,1 2,2"}, "mask: a polygon wants at least three corners"),
        ({"mask": "nowhere.tif"}, "nowhere.tif: no such file"),
        ({"top": "glued"}, "top: cannot read 'glued'"),
        ({"bottom": "moved 0 -99"}, "bottom: moves by 99 px but the image is only 61 px"),
        ({"background": "elastic"}, "background: an elastic one wants an edge"),
        ({"background": "nowhere.tif"}, "nowhere.tif: no such file"),
        (
            {"roi": (0, 10, 90, 40), "extent": (0, 0, 90, 61), "top": "fixed"},
            "top: the sample's extent goes on beyond it; say 'outside fixed'",
        ),
        (
            {"background": "elastic", "top": "fixed", "extent": (5, 5, 20, 20)},
            "extent: the sample must hold the whole region",
        ),
    ],
)
def test_bad_descriptions_end_before_any_work(files, more, message):
    with pytest.raises(eofm.InputError, match=message) as caught:
        read_scene(describe(files, **more))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_an_inverted_mask_is_told(files, pair, rng, noise):
    sample = np.zeros(pair[0].shape, np.uint8)
    sample[10:50, 15:75] = 1
    tifffile.imwrite(files / "mask.tif", sample)
    for name, I in zip(("before", "after"), pair[:2], strict=True):
        I = np.where(sample, I + 0.1, 0) + noise * rng.normal(size=I.shape)
        tifffile.imwrite(files / f"{name}.tif", I.astype(np.float32))
    masked = describe(files, mask=str(files / "mask.tif"))
    if noise:
        assert analyse(masked, estimation=QUICK).trust.verdict == "failed"
    else:
        message = "mask: no pixel outside of it .* data; is it the wrong way round"
        with pytest.raises(eofm.InputError, match=message):
            analyse(masked, estimation=QUICK)


def test_a_folder_that_cannot_be_made_is_told_before_any_work(files, monkeypatch):
    (files / "text").touch()
    with pytest.raises(eofm.InputError, match=r"new: nothing can be written to .*text; name"):
        check_results(files / "text" / "new", describe(files))
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(eofm.InputError, match=rf"new: nothing can be written to {files}; name"):
        check_results(files / "deep" / "new", describe(files))


def test_a_sample_is_identified_with_the_motion_that_the_images_show(tmp_path):
    """The bottom moves by 2 px, not by the 2.2 px stated."""
    for name, I in zip(("before", "after"), pressed.pair()[:2], strict=True):
        tifffile.imwrite(tmp_path / f"{name}.tif", I.astype(np.float32))
    pair = describe(
        tmp_path, top="fixed", bottom="moved 0 -2.2", poisson_ratio=0.492, stiffness=True
    )
    found = analyse(pair)
    factor = found.summary["stiffness"]["edge_motion_factor"]
    assert 2.2 * factor == pytest.approx(2.0, abs=0.05)
    np.testing.assert_allclose(found.u[1, -1], -2.2 * factor, atol=1e-9)
    found.write(tmp_path)
    assert tifffile.imread(tmp_path / "stiffness.tif").shape == found.first.shape
    assert tifffile.imread(tmp_path / "stiffness_deviation.tif").min() > 0
    assert tifffile.imread(tmp_path / "deviation.tif").shape == found.u.shape
    analyse(describe(tmp_path, error_bars=0), estimation=QUICK).write(tmp_path, kinds=())
    assert not (tmp_path / "stiffness.tif").exists()
    assert not (tmp_path / "deviation.tif").exists()


def test_a_stiffness_that_cannot_be_told_is_said_and_the_displacement_kept(tmp_path, caplog):
    """The bottom moves by 2 px, not by the 4 px stated."""
    for name, I in zip(("before", "after"), pressed.pair()[:2], strict=True):
        tifffile.imwrite(tmp_path / f"{name}.tif", I.astype(np.float32))
    pair = describe(tmp_path, top="fixed", bottom="moved 0 -4", stiffness=True, error_bars=0)
    found = analyse(pair)
    assert found.summary["stiffness"]["modulus_range"] is None
    assert "contradict the motion of the edges" in found.summary["stiffness"]["refused"]
    assert "no stiffness: the images contradict" in caplog.text
    np.testing.assert_allclose(found.u[1, -1], -4, atol=1e-9)
    found.write(tmp_path, kinds=())
    assert "No stiffness" in (tmp_path / "report.html").read_text()
    assert not (tmp_path / "stiffness.tif").exists()


def test_a_scene_says_where_the_sample_goes_on_and_what_of_it_is_shown(files):
    part = {"roi": (10, 10, 60, 40), "extent": (10, 0, 80, 61)}
    scene = read_scene(describe(files, **part, left="outside", stiffness=True))
    assert set(scene.known.outside) == {"left", "top", "right", "bottom"}
    assert scene.sample.shape == (40, 60)
    whole = read_scene(describe(files, bottom="outside moved 0 -2.5"))
    assert whole.known.outside == ("bottom",)


def test_large_motions_that_the_preset_follows_do_not_mislead_the_tracker(rng):
    """Ten degrees of rotation: bubbles are sought where the images say they went."""
    from conftest import speckle

    x2, x1 = np.mgrid[:128, :160].astype(float)
    c, s = np.cos(np.radians(10)) - 1, np.sin(np.radians(10))
    u = np.stack([c * (x1 - 80) - s * (x2 - 64), s * (x1 - 80) + c * (x2 - 64)])
    big = speckle((208, 240), rng, 2.0)
    I1 = big[40:168, 40:200]
    v = np.stack([c * (x1 - 80) + s * (x2 - 64), -s * (x1 - 80) + c * (x2 - 64)])
    I2 = evaluate(big, np.stack([x1, x2]) + v + 40)
    results = eofm.analyse(I1, I2, measures=eofm.Measures(error_bars=0))
    inner = np.s_[24:-24, 24:-24]
    assert np.hypot(*(results.u - u))[inner].mean() < 0.05
    assert results.trust.verdict == "good"
    assert results.summary["trust"][0]["verdict"] == "good"


def test_a_pair_that_has_nothing_in_common_is_told_in_the_results(rng, tmp_path):
    from conftest import speckle

    results = eofm.analyse(*(speckle((64, 80), rng) for _ in range(2)))
    assert results.trust.verdict == "failed"
    results.write(tmp_path, kinds=())
    told = json.loads((tmp_path / "summary.json").read_text())["trust"][0]
    assert told["verdict"] == "failed"
    assert told["reasons"]


def test_dead_zones_hold_no_number_in_what_is_written(files, truth):
    sides = {"lateral_size": 2.0, "axial_size": 2.0}
    results = analyse(describe(files, mask="10,10 30,10 30,30 10,30", **sides), estimation=QUICK)
    results.write(files, kinds=())
    for name in ("displacement", "displacement_um", "strain", "deviation", "trust"):
        written = tifffile.imread(files / f"{name}.tif")
        assert np.isnan(written[..., 20, 20]).all(), name
        assert np.isfinite(written[..., 40, 40]).all(), name
    assert np.isfinite(results.u).all()
