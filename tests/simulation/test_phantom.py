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
