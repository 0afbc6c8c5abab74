import numpy as np
import pandas as pd
import pytest
from conftest import speckle
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

import eofm
from eofm.app.config import load
from eofm.imaging import bubbles as tracker
from eofm.imaging.bubbles import UNMATCHED, agree, assign, detect, register
from eofm.imaging.splines import evaluate_field


@pytest.fixture(scope="module")
def paper(request):
    """The default experiment: true field, background, settings."""
    config = load(request.config.rootpath / "config" / "config.yaml")
    return eofm.true_field(config.sample), eofm.background_field(config.sample), config


@pytest.mark.parametrize(("noise", "rms", "largest"), [(0.0, 0.07, 0.7), (0.03, 0.12, 1.0)])
def test_accuracy_on_the_default_phantom(paper, noise, rms, largest):
    truth, background, config = paper
    settings = config.phantom.changed(noise=noise)
    I1, I2, bubbles = eofm.make_phantom(truth, settings)
    table = eofm.track(I1, I2, config.tracking, prediction=background)
    x, u = (table[list(names)].to_numpy().T for names in (("x1", "x2"), ("u1", "u2")))
    errors = u - evaluate_field(truth, x)
    assert np.sqrt((errors**2).mean(1)).max() <= rms
    assert abs(errors).max() <= largest
    if noise == 0:
        true = bubbles[["x1", "x2"]].to_numpy()
        assert len(table) >= 0.7 * len(true)
        alone = KDTree(true).query(true, k=2)[0][:, 1] > 3 * settings.sigma[0]
        found = KDTree(x.T).query(true)[0] < 1
        assert found[alone].mean() >= 0.92


def test_bubbles_near_the_edges_are_kept(pair, background):
    I1, I2, true = pair
    table = eofm.track(I1, I2, prediction=background)
    height, width = I1.shape

    def near_edge(t):
        return ((t.x1 < 4) | (t.x1 > width - 5) | (t.x2 < 4) | (t.x2 > height - 5)).sum()

    assert near_edge(table) > 0.5 * near_edge(true)


def test_no_motion_gives_zero(rng):
    I = speckle((48, 65), rng)
    table = eofm.track(I, I)
    assert len(table) > 20
    np.testing.assert_allclose(table[["u1", "u2"]], 0, atol=1e-10)
    np.testing.assert_allclose(table.quality, 1, atol=1e-9)


def test_brightness_scale_does_not_matter(pair):
    I1, I2, _ = pair
    a, b = eofm.track(I1, I2), eofm.track(200 * I1 + 40, 200 * I2 + 40)
    np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)


def test_large_motion_needs_the_prediction():
    u = np.full((2, 60, 80), 6.0)
    I1, I2, _ = eofm.make_phantom(u, eofm.Phantom(count=40, sigma=(2, 2)))
    table = eofm.track(I1, I2, prediction=u + 0.5)
    assert len(table) >= 20
    np.testing.assert_allclose(table[["u1", "u2"]], 6, atol=0.05)


def test_detection_finds_area_brightness_and_centre():
    x2, x1 = np.mgrid[:40, :50]
    I = np.exp(-((x1 - 20.3) ** 2 + (x2 - 11.8) ** 2) / (2 * 2.0**2))
    table = detect(I)
    assert len(table) == 1
    np.testing.assert_allclose(table[["x1", "x2"]].iloc[0], [20.3, 11.8], atol=0.05)
    # Area of the disc where the Gaussian of 2 px, smoothed by 0.7 px, is above 10 %.
    assert table.area[0] == pytest.approx(np.pi * 2 * (2**2 + 0.7**2) * np.log(10), rel=0.2)


def test_size_filter():
    I = np.zeros((40, 50))
    I[10, 10] = I[25:35, 20:40] = 1
    both = detect(I, eofm.Tracking(smoothing=0, min_area=1, max_area=400))
    assert sorted(both.area) == [1, 200]
    assert detect(I, eofm.Tracking(smoothing=0, min_area=2, max_area=400)).area.tolist() == [200]
    assert detect(I, eofm.Tracking(smoothing=0, min_area=1, max_area=100)).area.tolist() == [1]


def frame(points, brightness=1.0, area=9.0):
    x1, x2 = np.transpose(points)
    return pd.DataFrame({"x1": x1, "x2": x2, "brightness": brightness, "area": area})


def test_matching_is_one_to_one_and_of_least_cost():
    before = frame([(10.0, 10), (12, 10), (30, 30)])
    after = frame([(12.1, 10), (14.1, 10), (60, 60)])
    i, j = assign(before, after, np.full((2, 3), [[2.0], [0]]), gate=3.0)
    assert dict(zip(i, j, strict=True)) == {0: 0, 1: 1}


def test_matching_prefers_what_looks_alike():
    before = frame([(10.0, 10)])
    after = frame([(11.0, 10), (9, 10)], brightness=[0.2, 1.0])
    _, j = assign(before, after, np.zeros((2, 1)), gate=3.0)
    assert j.tolist() == [1]


@pytest.mark.parametrize("assigned", [1, 7, 10**6])
def test_matches_are_those_of_the_full_assignment(monkeypatch, rng, assigned):
    """Clusters assigned apart, a few or all at once, are a dense problem's optimum."""
    monkeypatch.setattr(tracker, "ASSIGNED", assigned)
    gate, n = 3.0, 150
    # From far apart at the left to one cluster of many at the right.
    points = rng.uniform(0, 1, (n, 2)) ** [0.4, 1] * [60, 60]
    before = frame(points, rng.uniform(0.1, 1, n), rng.uniform(5, 50, n))
    moved = np.concatenate([points[20:] + rng.normal(0, 1, (n - 20, 2)), [(-50.0, 0)]])
    after = frame(moved, rng.uniform(0.1, 1, n - 19), rng.uniform(5, 50, n - 19))
    distance = cdist(points, moved)
    brightness, area = (
        np.abs(np.log(before[[k]].to_numpy() / after[k].to_numpy())) for k in ("brightness", "area")
    )
    cost = (distance / gate) ** 2 + 0.5 * brightness + 0.25 * area
    cost = np.where(distance <= gate, cost, 1e3)
    rows, columns = linear_sum_assignment(np.hstack([cost, np.full((n, n), UNMATCHED)]))
    i, j = assign(before, after, np.zeros((2, n)), gate)
    matched = columns < len(after)
    np.testing.assert_array_equal(i, rows[matched])
    np.testing.assert_array_equal(j, columns[matched])
    assert 50 < len(i) < n - 20


def test_a_bubble_is_registered_the_same_alone_and_among_others(monkeypatch, rng):
    I1, I2 = speckle((50, 67), rng), speckle((50, 67), rng)
    I2 = 0.2 * I2 + 0.8 * np.roll(I1, 1, axis=1)
    x, start = rng.uniform([[0], [0]], [[66], [49]], (2, 30)), rng.normal(0.5, 0.5, (2, 30))
    motion, quality = register(I1, I2, x, start, 2.0)
    monkeypatch.setattr(tracker, "SAMPLES", 500)
    few = register(I1, I2, x, start, 2.0)
    np.testing.assert_allclose(few[0], motion, atol=1e-12)
    np.testing.assert_allclose(few[1], quality, atol=1e-12)


def test_touching_bubbles_are_told_apart_and_weighed():
    x2, x1 = np.mgrid[:30, :40]
    blobs = [np.exp(-((x1 - c) ** 2 + (x2 - 14) ** 2) / 8) for c in (15, 22)]
    I = blobs[0] + 0.6 * blobs[1]
    table = detect(I, eofm.Tracking(smoothing=0.0, threshold=0.05)).sort_values("x1")
    assert len(table) == 2
    level = np.percentile(I, 0.5) + 0.05 * np.diff(np.percentile(I, [0.5, 99.5]))
    np.testing.assert_allclose(table.brightness, [I[14, 15], I[14, 22]] - level, atol=1e-12)
    assert table.area.sum() == np.count_nonzero(level < I)
    np.testing.assert_allclose(table.x2, 14, atol=1e-9)


def test_a_motion_against_its_neighbours_is_dropped(rng):
    x = rng.uniform(0, 60, (2, 80))
    motion = np.stack([0.02 * x[0], -0.03 * x[1]])
    motion[:, 7] += [0, 2]
    kept = agree(x, motion, eofm.Tracking())
    assert not kept[7]
    assert kept.sum() == 79


def test_no_bubble_found_says_what_to_do(rng):
    I = rng.uniform(size=(20, 20))
    with pytest.raises(eofm.InputError, match=r"no bubble found in the image before.*lower"):
        eofm.track(I, I, eofm.Tracking(min_area=500, max_area=501))


def test_nothing_followed_says_what_to_do():
    I1, I2 = np.zeros((2, 40, 60))
    I1[8:11, 8:11] = I2[30:33, 50:53] = 1
    with pytest.raises(
        eofm.InputError, match="none of 1 bubbles could be followed; raise the gate"
    ):
        eofm.track(I1, I2)


def test_bubbles_along_the_last_column_stay_inside(rng):
    I = np.zeros((400, 20))
    I[:, -1] = np.abs(rng.normal(size=400))
    found = tracker.detect(I, eofm.Tracking(smoothing=0.0, min_area=1))
    assert len(found) > 50
    assert found.x1.max() == 19


def affine(x):
    """A small motion of points, shape (3, ...)."""
    A = np.array([[0.02, -0.01, 0.01], [0.01, -0.03, 0.0], [-0.01, 0.02, 0.025]])
    return np.tensordot(A, x, 1) + np.reshape([0.3, 0.2, -0.4], (3, *[1] * (x.ndim - 1)))


def test_bubbles_of_a_volume_move_as_it_does():
    """Translated, stretched and sheared, with 1 % of noise."""
    shape = (34, 40, 46)
    u = affine(np.indices(shape)[::-1])
    settings = eofm.Phantom(count=70, sigma=(1.5, 1.8), distance=7, noise=0.01, seed=2)
    I1, I2, bubbles = eofm.make_phantom(u, settings)
    table = eofm.track(I1, I2)
    names = ["x1", "x2", "x3", "u1", "u2", "u3", "area", "brightness", "quality"]
    assert list(table) == names
    assert len(table) > 55
    x, motion = (table[[f"{a}{k}" for k in (1, 2, 3)]].to_numpy().T for a in "xu")
    errors = motion - affine(x)
    assert np.sqrt((errors**2).mean()) < 0.02
    assert abs(errors).max() < 0.1
    # Areas are those of discs: of Gaussians of 1.65 px, smoothed, above 10 %.
    expected = np.pi * 2 * (1.65**2 + 0.7**2) * np.log(10)
    assert table.area.median() == pytest.approx(expected, rel=0.15)
    true = bubbles[["x1", "x2", "x3"]].to_numpy()
    assert KDTree(true).query(x.T)[0].max() < 1
    predicted = eofm.track(I1, I2, prediction=u)
    assert len(predicted) >= len(table)


def test_no_motion_of_a_volume_gives_zero(rng):
    I = speckle((16, 21, 24), rng)
    table = eofm.track(I, I)
    assert len(table) > 10
    np.testing.assert_allclose(table[["u1", "u2", "u3"]], 0, atol=1e-6)
    np.testing.assert_allclose(table.quality, 1, atol=1e-6)


def test_volumes_without_bubbles_say_so(rng):
    I = rng.uniform(size=(8, 9, 10))
    with pytest.raises(eofm.InputError, match=r"no bubble found in the volume before"):
        eofm.track(I, I, eofm.Tracking(min_area=500, max_area=501))
    with pytest.raises(eofm.InputError, match="window: 12 px is wider than the volume, 10 x 9 x 8"):
        eofm.track(I, I, eofm.Tracking(window=12))


def test_matching_in_a_volume_looks_along_all_axes():
    before = frame([(10.0, 10), (10, 10)]).assign(x3=[5.0, 9.0])
    after = frame([(10.0, 10), (10, 10)]).assign(x3=[10.0, 6.0])
    i, j = assign(before, after, np.full((3, 2), [[0.0], [0], [1]]), gate=1.0)
    assert dict(zip(i, j, strict=True)) == {0: 1, 1: 0}
