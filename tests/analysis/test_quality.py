import numpy as np
from conftest import speckle

from eofm.analysis.quality import _smallest, data_share, inconsistency, residual
from eofm.imaging.splines import gradient

STILL = np.zeros((2, 30, 40))


def test_the_true_field_leaves_no_residual(rng):
    I = speckle((30, 40), rng)
    np.testing.assert_allclose(residual(I, I, STILL), 0, atol=1e-12)
    moved = STILL.copy()
    moved[0] = 3
    left = residual(I, np.roll(I, 3, axis=1), moved)
    assert np.isnan(left[:, -3:]).all()
    np.testing.assert_allclose(left[:, 5:-5], 0, atol=1e-12)


def test_a_field_and_its_inverse_are_consistent():
    there = STILL + [[[2.0]], [[-1.0]]]
    error = inconsistency(there, -there)
    assert np.isnan(error[:, -2:]).all()
    assert np.isnan(error[0]).all()
    np.testing.assert_allclose(error[1:, :-2], 0, atol=1e-12)
    np.testing.assert_allclose(inconsistency(STILL, there), np.sqrt(5))


def test_data_decides_where_there_is_contrast_in_both_directions(rng):
    I = np.zeros((60, 90))
    I[:, :30] = speckle((60, 30), rng)
    I[:, 60:] = np.tile(np.sin(np.arange(30)), (60, 1))
    nowhere = np.zeros(I.shape, bool)
    share = data_share(I, "gradient", 0.05, 5.0, (1.0, 1.0), nowhere)
    assert share[10:50, 5:20].min() > 0.3
    assert share[10:50, 45].max() < 0.1
    # Stripes say nothing of the motion along them.
    assert share[20:40, 75:80].max() < 0.1
    dead = nowhere.copy()
    dead[:, :30] = True
    assert data_share(I, "gradient", 0.05, 5.0, (1.0, 1.0), dead)[10:50, 5:15].max() < 0.1


def test_the_share_is_small_where_a_smooth_motion_is_averaged_over_more(rng):
    """Over 27 px instead of sigma, 5: less than a thousandth, though all comes from the images."""
    I = speckle((60, 90), rng)
    strength = np.square(gradient(I, (1.0, 1.0))).sum(0).mean()
    nowhere = np.zeros(I.shape, bool)
    shares = [
        np.median(data_share(I, "bending", strength * reach**4, 5.0, (1.0, 1.0), nowhere))
        for reach in (5, 27)
    ]
    assert 0.1 < shares[0] < 0.3
    assert 1e-4 < shares[1] < 1e-3


def test_strains_are_inverted_up_to_the_edges():
    x2, x1 = np.mgrid[:30, :40].astype(float)
    there = np.stack([0.05 * (x1 - 20), -0.04 * x2])
    # What is at y came from x = (y1 + 1) / 1.05, y2 / 0.96.
    back = np.stack([(x1 + 1) / 1.05 - x1, x2 / 0.96 - x2])
    error = inconsistency(there, back)
    assert np.isfinite(error[:, 20])[:-1].all()
    np.testing.assert_allclose(error[np.isfinite(error)], 0, atol=1e-12)


def test_smallest_eigenvalues_are_those_of_numpy(rng):
    B = rng.normal(size=(200, 3, 3))
    B[:20, 2] = B[:20, 1]
    A = B @ B.transpose(0, 2, 1)
    A[20:23] = np.diag([2.0, 2.0, 2.0]), np.diag([0.0, 0.0, 0.0]), np.diag([1.0, 5.0, 5.0])
    parts = A[:, 0, 0], A[:, 0, 1], A[:, 0, 2], A[:, 1, 1], A[:, 1, 2], A[:, 2, 2]
    np.testing.assert_allclose(_smallest(*parts), np.linalg.eigvalsh(A)[:, 0], atol=1e-7)


def test_volumes_say_where_the_data_decide(rng):
    I = np.zeros((24, 30, 60), np.float32)
    I[..., :30] = speckle((24, 30, 30), rng)
    # What does not change from slice to slice says nothing of the motion across them.
    I[..., 30:] = speckle((30, 30), rng)
    nowhere = np.zeros(I.shape, bool)
    share = data_share(I, "gradient", 0.02, 3.0, (1.0, 1.0, 1.0), nowhere)
    assert share.dtype == np.float32
    assert np.median(share[8:16, 8:22, 5:22]) > 0.3
    assert share[8:16, 8:22, 42:56].max() < 0.05


def test_volumes_moved_there_and_back_are_consistent(rng):
    I = speckle((12, 20, 16), rng).astype(np.float32)
    there = np.zeros((3, *I.shape), np.float32) + np.reshape([2, -1, 1], (3, 1, 1, 1))
    error = inconsistency(there, -there)
    assert np.isnan(error[-1]).all()
    np.testing.assert_allclose(error[:-1, 1:, :-2], 0, atol=1e-5)
    left = residual(I, np.roll(I, 1, axis=0), there * np.reshape([0, 0, 1], (3, 1, 1, 1)))
    np.testing.assert_allclose(left[2:-2], 0, atol=1e-4)
