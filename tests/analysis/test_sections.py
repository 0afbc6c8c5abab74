import numpy as np

from eofm.analysis.sections import middle, picture, side


def test_sections_are_cut_where_they_meet_and_face_each_other(rng):
    V = rng.normal(size=(6, 9, 12))
    k, j, i = middle(V.shape)
    shown = picture(V, (1.0, 1.0, 1.0))
    np.testing.assert_array_equal(shown[:9, :12], V[k])
    np.testing.assert_array_equal(shown[:9, -6:], V[:, :, i].T)
    np.testing.assert_array_equal(shown[-6:, :12], V[:, j])
    assert np.isnan(shown[9:-6]).all()
    assert np.isnan(shown[-6:, -6:]).all()


def test_sections_have_true_proportions():
    V = np.zeros((10, 20, 40))
    shown = picture(V, (2.0, 3.0, 8.0))
    gap = shown.shape[0] - 30 - 40
    assert gap > 0
    assert shown.shape == (30 + gap + 40, 40 + gap + 40)
    assert side((2.0, 3.0, 8.0), 3) == (2.0, 2.0)


def test_an_image_is_its_own_picture(rng):
    I = rng.normal(size=(5, 7))
    assert picture(I, (4.0, 2.0)) is I
    assert side((4.0, 2.0), 2) == (4.0, 2.0)
