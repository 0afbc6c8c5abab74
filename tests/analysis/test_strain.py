import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eofm.analysis.strain import strain
from eofm.analysis.summary import of_strain
from eofm.errors import InputError
from eofm.settings import Measures


@given(st.integers(8, 40), st.integers(8, 40), st.floats(0.5, 8), st.integers(0, 2**20))
def test_linear_displacements_are_exact_up_to_the_edges(height, width, window, seed):
    G = np.random.default_rng(seed).normal(size=(2, 2))
    x2, x1 = np.mgrid[:height, :width].astype(float)
    u = np.stack([G[0, 0] * x1 + G[0, 1] * x2, G[1, 0] * x1 + G[1, 1] * x2 + 3])
    e = strain(u, (1.0, 1.0), window)
    expected = [G[0, 0], G[1, 1], (G[0, 1] + G[1, 0]) / 2]
    np.testing.assert_allclose(e.mean((1, 2)), expected, atol=1e-6)
    assert np.ptp(e, axis=(1, 2)).max() < 1e-5


def test_true_lengths_of_pixels_that_are_not_square():
    x2, x1 = np.mgrid[:30, :50].astype(float)
    # A shear of 1 % in um on pixels of 4 x 2 um, in px.
    u = np.stack([0.01 * (2 * x2) / 4, 0 * x1])
    e = strain(u, (4.0, 2.0), 12.0)
    np.testing.assert_allclose(e[2], 0.005, atol=1e-9)
    np.testing.assert_allclose(e[:2], 0, atol=1e-9)


def test_the_window_has_one_width_along_all_axes():
    """Waves that are as long in um are averaged alike, however many pixels they have."""
    sides, window, wave = (2.0, 5.0), 12.0, 80.0
    x2, x1 = (side * x for side, x in zip(sides[::-1], np.mgrid[:80, :200], strict=True))
    u = np.stack([np.sin(2 * np.pi * x / wave) / h for x, h in zip((x1, x2), sides, strict=True)])
    e = strain(u, sides, window)[:2, 20:-20, 50:-50]
    lateral, axial = (np.abs(component).max() for component in e)
    assert lateral == pytest.approx(axial, rel=0.05)
    assert lateral < 0.7 * 2 * np.pi / wave
    assert "the same along all axes" in (Measures.model_fields["strain_window"].description or "")


def test_noise_is_averaged_as_the_window_grows(rng):
    u = rng.normal(0, 0.05, (2, 80, 80))
    spread = [strain(u, (1.0, 1.0), w).std() for w in (1, 2, 4)]
    # The deviation of a slope under Gaussian weights falls with the square of the width.
    assert spread[0] / spread[1] == pytest.approx(4, rel=0.3)
    assert spread[1] / spread[2] == pytest.approx(4, rel=0.3)


def test_a_window_below_a_pixel_is_refused():
    with pytest.raises(InputError, match="strain_window: 1 um is less than half a pixel"):
        strain(np.zeros((2, 9, 9)), (10.0, 10.0), 1.0)


def test_compression_is_negative():
    x2, _ = np.mgrid[:20, :20].astype(float)
    assert strain(np.stack([0 * x2, -0.02 * x2]), (5.0, 5.0), 10)[1].max() < -0.0199


def test_six_components_of_a_volume_are_exact_for_linear_displacements(rng):
    G = rng.normal(size=(3, 3))
    sides = 4.0, 2.0, 5.0
    x = np.stack(np.mgrid[:20, :30, :40][::-1]).astype(float)
    lengths = np.reshape(sides, (3, 1, 1, 1))
    u = np.einsum("ij,j...->i...", G, x * lengths) / lengths
    e = strain(u.astype(np.float32), sides, 15.0)
    assert e.dtype == np.float32
    shear = [(G[i, j] + G[j, i]) / 2 for i, j in ((0, 1), (0, 2), (1, 2))]
    expected = np.reshape([*np.diag(G), *shear], (6, 1, 1, 1))
    np.testing.assert_allclose(e, np.broadcast_to(expected, e.shape), atol=2e-5)


def test_a_volume_that_goes_on_as_an_image_has_the_image_s_strain(rng):
    u = rng.normal(size=(2, 30, 40))
    volume = np.concatenate([u, 0 * u[:1]])[:, None].repeat(9, axis=1)
    e = strain(volume, (3.0, 2.0, 7.0), 10.0)
    np.testing.assert_allclose(e[[0, 1, 3], 4], strain(u, (3.0, 2.0), 10.0), atol=1e-6)
    np.testing.assert_allclose(e[[2, 4, 5]], 0, atol=1e-6)


def test_the_mean_is_that_of_what_the_images_show():
    """Air is filled in, and so is its strain."""
    e = np.zeros((3, 10, 12))
    e[1] = -0.02
    e[1, :4], air = 0.3, np.zeros((10, 12), dtype=bool)
    air[:4] = True
    found = of_strain(e, Measures(), 3.0, air)
    assert found["axial_strain_mean"] == pytest.approx(-0.02)
    assert found["strains"]["e22 axial"]["high"] == pytest.approx(-0.02)
    # Where they show nothing, all of it is all there is.
    everywhere = of_strain(e, Measures(), 3.0, np.ones_like(air))
    assert everywhere["axial_strain_mean"] == pytest.approx(e[1].mean())
