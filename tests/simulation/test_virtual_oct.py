"""The virtual microscope: its speckle, its point-spread function, its units."""

import numpy as np
import pytest
import tifffile

import eofm
from eofm.app.cli import main
from eofm.errors import InputError
from eofm.imaging.splines import warp
from eofm.simulation import virtual_oct
from eofm.simulation.virtual_oct import Scatterers, compress, echoes, fill, make_tomograms, region

# Speckle alone: no reflectors, no noise, no decay with depth.
PURE = {"scale": 1.0, "reflectors": 0, "attenuation": 0.0, "noise": 0.0}
SHAPE = (120, 160)


def settings(**changes):
    return eofm.VirtualOct(**PURE | changes)


def linear(a1, a2, shape=SHAPE):
    """The field (a1 x1, a2 x2), px."""
    x2, x1 = np.mgrid[: shape[0], : shape[1]].astype(float)
    return np.stack([a1 * x1, a2 * x2])


def constant(u1, u2, shape=SHAPE):
    return np.stack([np.full(shape, float(u1)), np.full(shape, float(u2))])


def intensity(scatterers, vo, shape=SHAPE):
    return np.abs(echoes(scatterers, *region(shape, vo.margin), vo)) ** 2


@pytest.mark.parametrize("pixel_size", [2.5, 5.0])
def test_matrix_is_fully_developed_speckle_of_mean_intensity_one(pixel_size):
    shape = (200, 300)
    vo = settings(pixel_size=pixel_size)
    I = intensity(fill(shape, vo), vo, shape)
    assert I.mean() == pytest.approx(1, abs=0.05)
    assert I.std() / I.mean() == pytest.approx(1, abs=0.06)
    # Negative exponential statistics: the part below the mean is 1 - 1/e.
    assert np.mean(I.mean() > I) == pytest.approx(1 - np.exp(-1), abs=0.02)


def test_speckle_decorrelates_with_strain_as_theory_says():
    vo = settings(pixel_size=2.0, axial_resolution=8.0, lateral_resolution=8.0, density=6.0)
    before = fill(SHAPE, vo)
    rows, columns = region(SHAPE, vo.margin)
    x2 = np.broadcast_to(rows[:, None], (len(rows), len(columns)))
    found, expected = [], []
    for strain in (0.0, 0.01, 0.02, 0.03, 0.05):
        after = before._replace(x=before.x * [[1.0], [1.0 - strain]])
        I1, I2 = intensity(before, vo), intensity(after, vo)
        moved, seen = warp(I2, np.stack([np.zeros_like(x2), -strain * x2]))
        found.append(np.corrcoef(I1[seen], moved[seen])[0, 1])
        w = vo.axial_resolution / (2 * np.sqrt(np.log(2)))
        phase = 4 * np.pi * vo.refractive_index / vo.wavelength * strain * w
        expected.append(np.exp(-(phase**2) / 2))
    assert np.all(np.diff(found) < 0)
    np.testing.assert_allclose(found, expected, atol=0.08)


def test_strong_reflectors_outlive_the_speckle():
    u = linear(0.0, -0.04)
    seen = []
    for reflectors in (0, 150):
        found = make_tomograms(u, u, settings(reflectors=reflectors))
        moved, inside = warp(found.I2, found.truth)
        seen.append(np.corrcoef(found.I1[inside], moved[inside])[0, 1])
    assert seen[0] < 0.3
    assert seen[1] > 0.6


def test_no_motion_gives_equal_images_but_for_noise():
    still = constant(0, 0)
    clean = make_tomograms(still, still, settings(reflectors=50, attenuation=1.0))
    np.testing.assert_array_equal(clean.I1, clean.I2)
    noisy = make_tomograms(still, still, settings(noise=0.5))
    assert 0 < np.abs(noisy.I1 - noisy.I2).mean() < 0.5


@pytest.mark.parametrize(("u1", "u2"), [(3, 0), (0, -2), (-1, 2)])
def test_a_shift_by_whole_pixels_shifts_the_image(u1, u2):
    u = constant(u1, u2)
    found = make_tomograms(u, u, settings(reflectors=60, margin=(0.1, 0.1)))
    moved = np.roll(found.I2, (-u2, -u1), axis=(0, 1))
    np.testing.assert_allclose(moved[4:-4, 4:-4], found.I1[4:-4, 4:-4], atol=1e-6)


def test_resolution_and_attenuation_have_their_units():
    vo = settings(margin=(0.0, 0.0), attenuation=1.5, lateral_resolution=10.0, pixel_size=5.0)
    I = intensity(Scatterers(np.array([[40.0], [60.0]]), np.array([2.0])), vo)
    depth = 60 * 5.0 / 1000
    assert I[60, 40] == pytest.approx(4 * np.exp(-2 * 1.5 * depth))
    assert I[60, 41] == pytest.approx(I[60, 40] / 2)
    assert I[:, 50:].max() == 0


def test_echoes_of_many_are_the_sum_of_each(monkeypatch, rng):
    """Against the sum written out, with scatterers beyond the region and in any order."""
    vo = eofm.VirtualOct(pixel_size=3.0, attenuation=1.0)
    rows, columns = region((40, 53), (0.1, 0.2))
    x, amplitude = rng.uniform(-8, 60, (2, 70)), rng.uniform(1, 5, 70)
    monkeypatch.setattr(virtual_oct, "AT_ONCE", 16)
    found = echoes(Scatterers(x, amplitude), rows, columns, vo)
    w1, w2 = virtual_oct.widths(vo)
    depth = x[1] * vo.pixel_size
    echo = amplitude * np.exp(-vo.attenuation * depth / 1000)
    echo = echo * np.exp(4j * np.pi * vo.refractive_index / vo.wavelength * depth)
    lateral = np.exp(-((columns[:, None] - x[0]) ** 2) / (2 * w1**2))
    axial = np.exp(-((rows[:, None] - x[1]) ** 2) / (2 * w2**2))
    np.testing.assert_allclose(found, np.einsum("rk,ck,k->rc", axial, lateral, echo), atol=1e-5)


def test_display_range():
    vo = settings(display=(-10.0, 30.0))
    shown = compress(np.array([[0.0, 10**-0.5, 1.0, 10**1.5, 1e3]], complex), vo)
    np.testing.assert_allclose(shown, [[0, 0, 0.25, 1, 1]], atol=1e-12)


def test_the_sample_is_enlarged_and_its_edges_are_cut_away():
    found = make_tomograms(linear(0.01, -0.03), linear(0.01, -0.02), settings(scale=2.0))
    height, width = 2 * (SHAPE[0] - 1) + 1, 2 * (SHAPE[1] - 1) + 1
    cut = np.ceil(0.05 * np.array([height - 1, width - 1])).astype(int)
    assert found.I1.shape == (height - 2 * cut[0], width - 2 * cut[1])
    assert found.I1.shape == found.I2.shape == found.truth.shape[1:]
    rows, columns = cut[0] + np.arange(found.I1.shape[0]), cut[1] + np.arange(found.I1.shape[1])
    for field, slope in ((found.truth, -0.03), (found.background, -0.02)):
        np.testing.assert_allclose(
            field[1], np.outer(slope * rows, np.ones(len(columns))), atol=1e-4
        )
        np.testing.assert_allclose(
            field[0], np.outer(np.ones(len(rows)), 0.01 * columns), atol=1e-4
        )


def test_same_seed_same_images_other_seed_others():
    u = linear(0.01, -0.02)
    a, b, c = (make_tomograms(u, u, eofm.VirtualOct(scale=1.0, seed=s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(a.I1, b.I1)
    np.testing.assert_array_equal(a.I2, b.I2)
    assert np.corrcoef(a.I1.ravel(), c.I1.ravel())[0, 1] < 0.3


def test_reflectors_stay_where_they_are_when_the_matrix_changes():
    sparse, dense = (fill(SHAPE, settings(reflectors=20, density=d)) for d in (2.0, 5.0))
    np.testing.assert_array_equal(sparse.x[:, -20:], dense.x[:, -20:])
    level = 20 * np.log10(dense.amplitude[-20:])
    assert 20 <= level.min() < level.max() <= 30


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"margin": [0.1, 0.5]}, r"margin: wants .* below 0.5 \(got 0.1, 0.5\)"),
        ({"margin": [-0.1, 0.1]}, r"margin: wants .* at least 0"),
        ({"display": [30, 0]}, r"display: wants low < high \(got 30, 0\)"),
        ({"reflector_level": [30, 20]}, "reflector_level: wants low <= high"),
        ({"wavelength": 0}, "wavelength: input should be greater than 0"),
        ({"noise": -1}, "noise: input should be greater than or equal to 0"),
        ({"reflector": 3}, "unknown key reflector; did you mean reflectors?"),
    ],
)
def test_wrong_settings_are_named_in_one_line(values, message):
    with pytest.raises(InputError, match=message) as caught:
        eofm.VirtualOct.parse(values, "virtual_oct")
    assert "\n" not in str(caught.value)


def test_unusable_fields_are_refused():
    with pytest.raises(InputError, match="compute both for one sample"):
        make_tomograms(constant(0, 0), constant(0, 0, (50, 50)))
    with pytest.raises(InputError, match="margin: leaves 2 x 16 px of a sample of 20 x 16 px"):
        make_tomograms(*2 * [constant(0, 0, (20, 16))], settings(margin=(0.0, 0.45)))


def test_command(tmp_path, capsys):
    names = ["u.tif", "bg.tif", "a.tif", "b.tif", "true.tif", "background.tif"]
    f = {name: str(tmp_path / name) for name in names}
    for name, field in (("u.tif", linear(0, -0.03)), ("bg.tif", linear(0, -0.02))):
        tifffile.imwrite(f[name], field)
    words = ["virtual-oct", f["u.tif"], f["bg.tif"], "--reference", f["a.tif"], "--deformed"]
    words += [f["b.tif"], "--truth", f["true.tif"], "--background", f["background.tif"]]
    assert main([*words, "--scale", "1", "--reflectors", "40"]) == 0
    I1 = tifffile.imread(f["a.tif"])
    assert I1.shape == tifffile.imread(f["true.tif"]).shape[1:]
    assert I1.min() == 0
    assert I1.max() <= 1
    assert main([*words, "--margin", "0.6", "0"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("eofm virtual-oct: ")
    assert error.count("\n") == 1
