import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist, pdist

import eofm
from eofm.simulation.phantom import scatter


def still(height=40, width=60):
    return np.zeros((2, height, width))


def test_same_seed_same_images_other_seed_others(truth):
    a, b, c = (eofm.make_phantom(truth, eofm.Phantom(seed=s, noise=0.1)) for s in (5, 5, 6))
    np.testing.assert_array_equal(a[0], b[0])
    np.testing.assert_array_equal(a[1], b[1])
    assert not np.allclose(a[0], c[0])


def test_noise_leaves_the_bubbles_where_they_are(truth):
    clean, noisy = (eofm.make_phantom(truth, eofm.Phantom(noise=n)) for n in (0, 0.03))
    assert clean[2].equals(noisy[2])
    difference = noisy[0] - clean[0]
    assert difference.std() == pytest.approx(0.03 * clean[2].brightness.max(), rel=0.05)
    assert abs(np.corrcoef(difference.ravel(), (noisy[1] - clean[1]).ravel())[0, 1]) < 0.05


def test_no_motion_gives_two_equal_images():
    before, after, bubbles = eofm.make_phantom(still(), eofm.Phantom(count=30))
    np.testing.assert_array_equal(before, after)
    assert not bubbles[["u1", "u2"]].to_numpy().any()


@given(st.integers(1, 30), st.floats(0, 4), st.integers(0, 2**20))
@settings(max_examples=25)
def test_bubbles_lie_in_the_sample_at_their_distance(count, distance, seed):
    _, _, bubbles = eofm.make_phantom(
        still(), eofm.Phantom(count=count, distance=distance, seed=seed)
    )
    x = bubbles[["x1", "x2"]].to_numpy()
    assert len(x) == count
    assert (x >= 0).all()
    assert (x <= [59, 39]).all()
    assert count == 1 or pdist(x).min() >= distance


@pytest.mark.parametrize(("count", "distance"), [(40, 5.0), (150, 2.5), (20, 0.01)])
def test_places_are_the_first_far_enough_from_all_before(count, distance):
    """Neighbours alone are asked, with the same answer."""
    found = scatter((40, 60), count, distance, np.random.default_rng(4)).T
    rng, points = np.random.default_rng(4), np.empty((0, 2))
    while len(points) < count:
        p = rng.uniform(0, [59, 39])[None]
        if (cdist(p, points) >= distance).all():
            points = np.concatenate([points, p])
    np.testing.assert_array_equal(found, points)


def test_impossible_distance_is_refused():
    with pytest.raises(eofm.InputError, match=r"room for only \d+ of 100 bubbles 20 px apart"):
        eofm.make_phantom(still(), eofm.Phantom(count=100, distance=20))


def test_brightness_and_base_level():
    I, _, bubbles = eofm.make_phantom(
        still(), eofm.Phantom(count=1, brightness=(0.3, 0.3), sigma=(2, 2), base=0.1)
    )
    assert I.min() == pytest.approx(0.1, abs=1e-6)
    assert I.sum() - 0.1 * I.size == pytest.approx(0.3 * 2 * np.pi * 4, rel=0.5)
    assert bubbles.brightness[0] == 0.3


def test_bubbles_of_a_volume_are_moved_and_rendered_again():
    """In single precision, each at its place and of its size."""
    u = np.zeros((3, 20, 24, 28), np.float32)
    u += np.reshape([1.25, -0.5, 0.75], (3, 1, 1, 1))
    settings = eofm.Phantom(count=25, sigma=(1, 2), base=0.125, seed=4)
    before, after, table = eofm.make_phantom(u, settings)
    assert before.dtype == after.dtype == np.float32
    assert list(table) == ["x1", "x2", "x3", "u1", "u2", "u3", "sigma", "brightness"]
    motion = table[["u1", "u2", "u3"]].to_numpy()
    np.testing.assert_allclose(motion, np.tile([1.25, -0.5, 0.75], (25, 1)), atol=1e-6)
    x, grid = table[["x1", "x2", "x3"]].to_numpy(), np.indices(before.shape)[::-1, ..., None]
    for I, centres in ((before, x), (after, x + motion)):
        squares = ((grid - np.reshape(centres.T, (3, 1, 1, 1, -1))) ** 2).sum(0)
        dense = np.exp(-squares / (2 * table.sigma.to_numpy() ** 2)) @ table.brightness.to_numpy()
        np.testing.assert_allclose(I, 0.125 + dense, atol=1e-6)


@pytest.mark.parametrize("overlap", ["sum", "brightest"])
def test_strained_bubbles_of_a_volume(overlap):
    """A sample that is stretched without bounds is its image, read where pixels came from."""
    A = np.diag([0.1, -0.15, 0.05])
    A[0, 2] = 0.08
    shape = (24, 26, 30)
    x = np.indices(shape)[::-1].astype(float)
    u = np.tensordot(A, x - np.reshape([15, 13, 12], (3, 1, 1, 1)), 1)
    settings = eofm.Phantom(count=1, sigma=(3, 3), strained=True, overlap=overlap, seed=3)
    _, after, table = eofm.make_phantom(u, settings)
    (c,), (m,) = (table[[f"{a}{k}" for k in (1, 2, 3)]].to_numpy() for a in "xu")
    back = np.tensordot(np.linalg.inv(np.eye(3) + A), x - np.reshape(c + m, (3, 1, 1, 1)), 1)
    expected = table.brightness[0] * np.exp(-(back**2).sum(0) / (2 * 3**2))
    np.testing.assert_allclose(after, expected, atol=1e-6)


def test_noise_of_a_volume_is_new_in_each_image_and_slice():
    u = np.zeros((3, 16, 18, 20))
    clean = eofm.make_phantom(u, eofm.Phantom(count=30))
    noisy, again = (eofm.make_phantom(u, eofm.Phantom(count=30, noise=0.05)) for _ in range(2))
    np.testing.assert_array_equal(clean[0], clean[1])
    np.testing.assert_array_equal(noisy[1], again[1])
    first, second = noisy[0] - clean[0], noisy[1] - clean[1]
    assert first.std() == pytest.approx(0.05 * clean[2].brightness.max(), rel=0.05)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(first[1:].ravel(), first[:-1].ravel())[0, 1]) < 0.05


@pytest.mark.parametrize(("count", "distance"), [(40, 5.0), (300, 2.5), (80, 0.0)])
def test_places_in_a_volume_are_the_first_far_enough_from_all_before(count, distance):
    found = scatter((12, 30, 24), count, distance, np.random.default_rng(4)).T
    rng, points = np.random.default_rng(4), np.empty((0, 3))
    while len(points) < count:
        p = rng.uniform(0, [23, 29, 11])[None]
        if (cdist(p, points) >= distance).all():
            points = np.concatenate([points, p])
    np.testing.assert_array_equal(found, points)


def test_impossible_distance_in_a_volume_is_refused():
    with pytest.raises(eofm.InputError, match="bubbles 20 px apart in 12 x 14 x 16 px"):
        eofm.make_phantom(np.zeros((3, 12, 14, 16)), eofm.Phantom(count=100, distance=20))
