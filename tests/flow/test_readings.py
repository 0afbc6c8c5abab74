"""What can be read into the paper's multi-scale scheme: each allowed reading, and the others."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from conftest import speckle

import eofm
from eofm.errors import InputError
from eofm.flow.images import Images
from eofm.flow.problem import Problem
from eofm.flow.pyramid import sampled
from eofm.grid import Grid
from eofm.imaging.splines import resize_field
from eofm.settings import WARPING

CHOICES = {
    "warped_by": ("u", "v", "nothing"),
    "smoothness_of": ("v", "update"),
    "ends": ("full", "half"),
    "lengths": ("finest", "scale"),
}
READINGS = [dict(zip(CHOICES, values, strict=True)) for values in product(*CHOICES.values())]
EDGES = ("top", "bottom")


def paper(**changes):
    return eofm.Estimation(**{"method": "paper", "scales": 3, "limits": (0, 1)} | changes)


@pytest.mark.parametrize("reading", READINGS, ids=lambda reading: "-".join(reading.values()))
def test_every_reading_brings_the_field_nearer_and_keeps_the_edges(
    reading, pair, truth, background
):
    I1, I2, bubbles = pair
    known = eofm.Known(bubbles=bubbles, background=background)
    u = eofm.estimate_displacement(I1, I2, paper(**reading, zero_edges=EDGES), known).u
    np.testing.assert_allclose(u[:, [0, -1]], background[:, [0, -1]], atol=1e-9)
    error, start = (eofm.relative_errors(f, truth)["e_rel"] for f in (u, background))
    assert error < 0.85 * start


@pytest.mark.parametrize("reading", READINGS, ids=lambda reading: "-".join(reading.values()))
def test_one_scale_is_the_same_in_every_reading(reading, pair, background):
    I1, I2, bubbles = pair
    known = eofm.Known(bubbles=bubbles, background=background)
    fields = [
        eofm.estimate_displacement(I1, I2, paper(**r, scales=1, zero_edges=EDGES), known).u
        for r in (reading, WARPING)
    ]
    np.testing.assert_allclose(*fields, atol=1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"smoothness": "bending"}, "warped_by: 'nothing' wants the smoothness 'gradient'"),
        ({"method": "preset", "ends": "half"}, "ends: 'half' wants the smoothness 'gradient'"),
        ({"start": "background"}, "start: 'background' wants images that are warped by u"),
        ({"warped_by": "v", "start": "background"}, "start: 'background' wants images"),
        ({"warps": 2}, "warps: wants 1 where nothing is warped"),
    ],
)
def test_what_would_have_no_effect_is_refused(settings, message):
    with pytest.raises(InputError, match=message) as error:
        eofm.Estimation.parse({"method": "paper"} | settings, "estimation")
    assert "\n" not in str(error.value)


def test_the_stiffness_wants_all_pixels(pair, sample):
    with pytest.raises(InputError, match="ends: the stiffness wants"):
        eofm.identify_stiffness(*pair[:2], sample, estimation=eofm.Estimation(method="paper"))


def test_a_smooth_update_costs_less_than_a_smooth_field(rng):
    """A stretch that coarse scales have found is not flattened again by R on updates."""
    I = speckle((49, 65), rng)
    x = rng.uniform(2, 46, (2, 120))
    table = pd.DataFrame({"x1": x[0], "x2": x[1], "u1": 0.1 * (x[0] - 24), "u2": 0 * x[1]})
    slope = {}
    for smoothness_of in CHOICES["smoothness_of"]:
        settings = paper(smoothness_of=smoothness_of, alpha=5, ends="full")
        u = eofm.estimate_displacement(0.01 * I, 0.01 * I, settings, eofm.Known(table)).u
        slope[smoothness_of] = np.diff(u[0, 24, 12:37]).mean() / 0.1
    assert 0 < slope["v"] < 0.8 * slope["update"] < 0.8


def test_lengths_of_each_scale_are_those_of_images_of_its_size(truth, background, pair):
    """Ending at half resolution is the whole scheme on images of half the size."""
    I1, I2, bubbles = pair
    shape = (31, 46)  # of 61 x 91
    I1, I2, u_bg = I1[:, :-1], I2[:, :-1], background[:, :, :-1]
    I1, I2 = (np.pad(I, ((0, 0), (0, 2)), mode="edge") for I in (I1, I2))
    u_bg = np.pad(u_bg, ((0, 0), (0, 0), (0, 2)), mode="edge")
    assert I1.shape == (61, 91)
    settings = paper(lengths="scale", ends="half", zero_edges=EDGES, scales=2)
    u = eofm.estimate_displacement(I1, I2, settings, eofm.Known(bubbles, u_bg)).u
    half = [sampled(I, [Grid(shape, (2, 2))])[0] for I in (I1, I2)]
    smaller = eofm.Known(bubbles[["x1", "x2", "u1", "u2"]] / 2, resize_field(u_bg, shape) / 2)
    v = eofm.estimate_displacement(*half, settings.changed(ends="full"), smaller).u
    difference = 2 * v - resize_field(u, shape)
    assert np.abs(difference).max() < 0.1
    assert np.sqrt((difference**2).mean()) < 0.02


def test_sigma_is_measured_in_px_of_the_scale(pair, background):
    """alpha and beta of the paper's F are then the same, so that sigma alone grows."""
    I1, I2, bubbles = pair
    known = eofm.Known(bubbles=bubbles, background=background)
    settings = paper(lengths="scale", scales=2, ends="full")
    coarse = Problem.of(I1.shape, settings, known)
    side = np.sqrt(np.prod(coarse.grids[0].spacing))
    wide = Problem.of(I1.shape, settings.changed(lengths="finest", sigma=5 * side), known)
    pair = Images.of(I1, I2, settings, known).pairs(coarse.grids, settings, known)[0]
    terms = [p.level(0, pair, p.u_bg).terms[0] for p in (coarse, wide)]
    np.testing.assert_allclose(terms[0].A, terms[1].A, rtol=1e-12)
    np.testing.assert_allclose(terms[0].b, terms[1].b, rtol=1e-12, atol=1e-15)
