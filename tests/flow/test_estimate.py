import numpy as np
import pandas as pd
import pytest
from conftest import speckle

import eofm
from eofm.grid import inside, precision
from eofm.imaging.gaussian import blur
from eofm.imaging.intensity import normalise
from eofm.imaging.splines import evaluate
from eofm.settings import WARPING

EDGES = ("top", "bottom")


@pytest.fixture(scope="module")
def papers_phantom():
    """Fields and images of the size of the paper's experiment."""
    inclusion = eofm.Inclusion(x1=107.1, x2=76.3, radius=30.4, stiffness=7.5)
    sample = eofm.Sample(height=108, width=180, inclusions=(inclusion,))
    truth = eofm.true_field(sample, eofm.Forward(true_cell=3.0))
    return truth, eofm.background_field(sample), *eofm.make_phantom(truth)[:2]


@pytest.mark.parametrize("shape", [(32, 32), (33, 48), (47, 40)])
@pytest.mark.parametrize("scales", [1, 3])
def test_no_motion_gives_zero(shape, scales, rng):
    I = speckle(shape, rng)
    bubbles = eofm.track(I, I)
    u = eofm.estimate_displacement(
        I, I, eofm.Estimation(method="paper", scales=scales), known=eofm.Known(bubbles=bubbles)
    ).u
    np.testing.assert_allclose(u, 0, atol=1e-10)


def test_known_edges_are_kept_exactly(pair, background):
    I1, I2, bubbles = pair
    settings = eofm.Estimation(method="paper", zero_edges=EDGES)
    u = eofm.estimate_displacement(
        I1, I2, settings, known=eofm.Known(bubbles=bubbles, background=background)
    ).u
    np.testing.assert_allclose(u[:, [0, -1]], background[:, [0, -1]], atol=1e-12)


@pytest.mark.parametrize("reading", [{}, WARPING], ids=["paper", "warping"])
def test_speckle_and_background_each_bring_the_field_nearer(papers_phantom, reading):
    """The paper's point: test 5 beats test 4, test 1 and test 3."""
    truth, background, I1, I2 = papers_phantom
    bubbles = eofm.track(I1, I2, prediction=background)

    def error(settings, background=None):
        settings = settings.changed(limits=(0.0, 1.0), **reading)
        u = eofm.estimate_displacement(
            I1, I2, settings, known=eofm.Known(bubbles=bubbles, background=background)
        ).u
        return eofm.relative_errors(u, truth)["e_rel"]

    test1 = error(eofm.Estimation(method="paper"))
    test3 = error(eofm.Estimation(method="paper", beta=0, zero_edges=EDGES), background)
    test4 = error(eofm.Estimation(method="paper", scales=1, zero_edges=EDGES), background)
    test5 = error(eofm.Estimation(method="paper", zero_edges=EDGES), background)
    assert test5 < min(test1, test3, test4)


def test_large_smooth_motion_of_dense_speckle(rng):
    """Four pixels of motion, far beyond the speckle, found within a few hundredths."""
    x2, x1 = np.mgrid[:96, :120].astype(float)
    u = np.stack([0.03 * (x1 - 60), -4 * x2 / 95])
    big = speckle((140, 160), rng, 2.0)
    I2 = big[20:116, 20:140]
    I1 = evaluate(big, np.stack([x1, x2]) + u + 20)
    found = eofm.estimate_displacement(
        I1, I2, eofm.Estimation(method="paper", alpha=0.02, scales=4, warps=4, **WARPING)
    ).u
    assert np.hypot(*(found - u))[5:-5, 5:-5].mean() < 0.03


def test_pixels_that_leave_the_image_do_no_harm(rng):
    """A sample that bulges out of the frame is followed up to the last pixel still seen."""
    x2, x1 = np.mgrid[:64, :96].astype(float)
    big = speckle((104, 136), rng, 2.0)
    I2 = big[20:84, 20:116]
    errors = []
    for sign in (1, -1):
        u = np.stack([sign * 5 * (x1 - 47.5) / 47.5, 0 * x2])
        I1 = evaluate(big, np.stack([x1, x2]) + u + 20)
        found = eofm.estimate_displacement(
            I1, I2, eofm.Estimation(method="paper", alpha=0.02, scales=4, warps=4, **WARPING)
        ).u
        seen = inside(I2.shape, np.stack([x1, x2]) + u)
        errors.append(np.hypot(*(found - u))[seen].mean())
    outwards, inwards = errors
    # Clamping to the border instead gives 0.14.
    assert outwards < 0.05
    assert outwards < inwards


def test_sizes_must_agree(rng):
    with pytest.raises(eofm.InputError, match="differ in size"):
        eofm.estimate_displacement(np.eye(20), np.eye(21))
    with pytest.raises(eofm.InputError, match="background: wanted"):
        eofm.estimate_displacement(
            np.eye(20), np.eye(20), known=eofm.Known(background=np.zeros((2, 20, 21)))
        )


@pytest.mark.parametrize(
    ("known", "message"),
    [
        ({"pixel_size": 2.0}, "pixel_size: wanted positive lengths"),
        ({"pixel_size": (1.0, -1.0)}, "pixel_size: wanted positive lengths"),
        ({"pixel_size": (1.0, np.nan)}, "pixel_size: wanted positive lengths"),
        ({"pixel_size": (1.0, 1.0, 1.0, 1.0)}, "pixel_size: wanted positive lengths"),
        ({"pixel_size": (1.0, 200.0)}, "200 and 1 differ by more than 100 times"),
        ({"dead": np.zeros((20, 24))}, "dead: wanted a mask of True and False, got float64"),
        ({"dead": np.zeros((24, 20), dtype=bool)}, r"dead: has the shape \(24, 20\)"),
        ({"dead": np.ones((20, 24), dtype=bool)}, "dead: the mask leaves no pixel"),
        ({"background": np.full((2, 20, 24), np.inf)}, "background: has NaN or infinite values"),
        ({"background": np.zeros((20, 24, 2))}, "background: wanted real numbers"),
        ({"edges": {"left": np.zeros((2, 24))}}, r"left: wanted real numbers of shape \(2, 20\)"),
        ({"edges": {"upper": np.zeros((2, 1))}}, "upper: is no edge"),
    ],
)
def test_what_is_known_has_to_fit(rng, known, message):
    I1, I2 = rng.uniform(size=(2, 20, 24))
    with pytest.raises(eofm.InputError, match=message):
        eofm.estimate_displacement(I1, I2, known=eofm.Known(**known))


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_a_mask_that_leaves_only_empty_image_may_be_inverted(rng, noise):
    """Dark, with some noise of the detector, is what is left of images around a sample."""
    sample = np.zeros((60, 80), dtype=bool)
    sample[10:50, 15:65] = True
    I1, I2 = (
        np.where(sample, I + 0.1, 0) + noise * rng.normal(size=I.shape)
        for I in eofm.make_phantom(np.full((2, 60, 80), 0.3), eofm.Phantom(seed=2))[:2]
    )
    with pytest.raises(eofm.InputError, match="no pixel outside of the mask carries data; is it"):
        eofm.estimate_displacement(I1, I2, known=eofm.Known(dead=sample))
    right = eofm.estimate_displacement(I1, I2, known=eofm.Known(dead=~sample))
    assert np.abs(right.u - 0.3)[:, sample].mean() < 0.05


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (None, "arrays of shape"),
        ([["a", "b"]], "something else than numbers"),
        (np.ma.masked_less(np.arange(600.0).reshape(20, 30), 5), "masked values"),
        (np.ones((20, 30), dtype=complex), "complex"),
    ],
)
def test_images_have_to_be_numbers(image, message):
    with pytest.raises(eofm.InputError, match=message):
        eofm.estimate_displacement(image, image)


@pytest.mark.parametrize("kind", [np.longdouble, np.int64, object, list])
def test_numbers_of_any_kind_are_read(rng, kind):
    I1, I2 = rng.integers(0, 255, (2, 20, 24))
    given = (I.tolist() if kind is list else I.astype(kind) for I in (I1, I2))
    settings = eofm.Estimation(alpha=1.0)
    found = eofm.estimate_displacement(*given, settings)
    np.testing.assert_array_equal(found.u, eofm.estimate_displacement(I1, I2, settings).u)


@pytest.mark.parametrize("row", [(200, 5, 0, 0), (5, 5, 1e9, 0), (-1, 5, 0, 0)])
def test_bubbles_of_another_image_are_refused(rng, row):
    I = speckle((40, 50), rng)
    table = pd.DataFrame([(9, 9, 0, 0), row], columns=["x1", "x2", "u1", "u2"])
    with pytest.raises(eofm.InputError, match="bubble 2 of 2 lies or moves outside"):
        eofm.estimate_displacement(I, I, known=eofm.Known(bubbles=table))


def test_table_of_true_bubbles_serves_as_well(pair, truth):
    """A user's own table needs only the four columns."""
    I1, I2, bubbles = pair
    u = eofm.estimate_displacement(
        I1, I2, known=eofm.Known(bubbles=bubbles[["x1", "x2", "u1", "u2"]])
    ).u
    assert eofm.relative_errors(u, truth)["e_rel"] < 40


def test_what_moves_into_a_dead_zone_carries_no_data(rng):
    """A zone that is filled in both images does not spoil what is below it and moves up."""
    x2, x1 = np.mgrid[:80, :96].astype(float)
    u = np.stack([0 * x1, -4 * x2 / 79])
    big = speckle((120, 136), rng, 2.0)
    I2 = big[20:100, 20:116].copy()
    I1 = evaluate(big, np.stack([x1, x2]) + u + 20)
    dead = np.zeros(I1.shape, dtype=bool)
    dead[30:50, 30:66] = True
    plain = eofm.estimate_displacement(I1, I2).u
    I1[dead] = I2[dead] = 0.5
    masked = eofm.estimate_displacement(I1, I2, known=eofm.Known(dead=dead)).u
    below = np.s_[50:56, 30:66]
    errors = [np.hypot(*(v - u))[below].mean() for v in (masked, plain)]
    assert errors[0] < 3 * errors[1] + 0.01


@pytest.mark.parametrize("shape", [(40, 44), (12, 20, 24)])
def test_images_that_are_given_stay_as_they_are(rng, shape):
    """Those between 0 and 1 are worked on without a copy."""
    I = [blur(rng.uniform(size=shape), (1.0,) * len(shape)) for _ in range(2)]
    low, high = min(J.min() for J in I), max(J.max() for J in I)
    I = [((J - low) / (high - low)).astype(precision(len(shape))) for J in I]
    before = [J.copy() for J in I]
    assert all(J is K for J, K in zip(normalise(*I), I, strict=True))
    for settings in (eofm.Estimation(), eofm.Estimation(method="paper", scales=1)):
        eofm.estimate_displacement(*I, settings)
    assert all((J == K).all() for J, K in zip(I, before, strict=True))
