"""Bubbles that are held out as a whole, and the prior that they ask for."""

import numpy as np
import pytest
from pressed import PLAIN, pair

from eofm.flow.estimate import estimate_displacement
from eofm.identification import choice, stiffness
from eofm.identification.choice import Choice, Prior, clearly_better, strongest
from eofm.identification.folds import COUNT, Folds
from eofm.identification.stiffness import identify_stiffness
from eofm.identification.uncertainty import deviations
from eofm.settings import Identification, Phantom
from eofm.simulation.phantom import make_phantom


@pytest.fixture(scope="module")
def folds():
    u = pair()[2]
    I1, I2, bubbles = make_phantom(u, Phantom(count=25, distance=9.0, seed=1))
    return Folds(estimate_displacement(I1, I2).match), bubbles, u


def test_every_bubble_is_held_out_once_and_as_a_whole(folds):
    found, bubbles, _ = folds
    masks = np.stack(found.masks)
    assert masks.shape[0] == COUNT
    assert (masks.sum(0) == 1).all()
    x2, x1 = np.mgrid[: PLAIN.height, : PLAIN.width]
    for row in bubbles.itertuples():
        near = np.hypot(x1 - row.x1, x2 - row.x2) < 1.5 * row.sigma
        assert len(np.unique(found.cells[near])) == 1


def test_the_loss_is_what_a_shift_takes_off(folds):
    """It is the least for the true motion, and quadratic in what is added to it."""
    found, _, u = folds
    shift = np.zeros_like(u)
    shift[1] = 0.1
    losses = [found.losses([u + k * shift] * COUNT).mean() for k in (-2, -1, 0, 1, 2)]
    assert min(losses) == losses[2]
    second = np.diff(losses, 2)
    assert np.ptp(second) < 1e-6 * second.mean()


def test_of_equals_the_strongest_is_taken():
    rng = np.random.default_rng(3)
    base = rng.uniform(1, 3, 80)
    weak = Choice(Prior(1.0), [], base)
    equal = Choice(Prior(3.0), [], base + rng.normal(0, 1, 80))
    worse = Choice(Prior(9.0), [], base + 1)
    assert strongest([worse, equal, weak], 2.0) is equal
    assert strongest([worse, weak], 2.0) is weak
    assert clearly_better(weak.losses, worse.losses, 2.0)


def test_one_bubble_far_from_all_others_does_not_decide():
    """It is lost to the first, which is better for all others."""
    losses = np.full(80, 6.0)
    first, second = losses - 2, losses
    first[0] = 1e4
    assert first.mean() > second.mean()
    chosen = [Choice(Prior(g), [], f) for g, f in ((1.0, second), (0.3, first))]
    assert strongest(chosen, 0.5).prior.gamma == 0.3


@pytest.fixture(scope="module")
def chosen():
    """What held-out bubbles of the pressed sample choose."""
    I1, I2, _ = pair()
    return identify_stiffness(I1, I2, PLAIN).choice


def test_priors_that_are_not_ruled_out_are_rivals(chosen):
    assert len(chosen.rivals) < 12
    z = chosen.fits[0].z
    assert all(not np.array_equal(rival[0].z, z) for rival in chosen.rivals)


def test_a_contrast_within_its_error_bars_is_refused(monkeypatch):
    """The same images: refused only where more is asked of its error bars."""
    monkeypatch.setattr(choice, "RIVAL", -100.0)  # total variation wins
    I1, I2, _ = pair()
    found = identify_stiffness(I1, I2, PLAIN)
    assert not found.refused
    clear = found.clarity
    # All that was chosen before error bars are asked is the same.
    monkeypatch.setattr(stiffness.Setup, "choose", lambda *_: (found.choice, ""))
    vague = identify_stiffness(I1, I2, PLAIN, Identification(clarity=1.1 * clear))
    assert "error bars" in vague.refused
    assert not vague.alone
    assert np.isnan(vague.E).all()
    assert np.isnan(deviations(vague, samples=2)[1]).all()
    assert np.isfinite(deviations(vague, samples=2)[0]).all()
    assert "displacement is that of the identified sample" in vague.summary()
    lost = identify_stiffness(I1, I2, PLAIN, Identification(clarity=2 * clear))
    assert lost.alone
    assert "displacement is the preset's" in lost.summary()


def test_what_predicts_worse_than_the_preset_is_refused(monkeypatch):
    """The preset is said to predict all that is held out."""
    I1, I2, _ = pair()
    monkeypatch.setattr(
        stiffness.Folds,
        "smooth",
        lambda self, estimate, backgrounds: [self.match.u] * COUNT,
    )
    monkeypatch.setattr(stiffness.Folds, "losses", _exact_for_preset(Folds.losses))
    found = identify_stiffness(I1, I2, PLAIN)
    assert found.refused
    assert np.isnan(found.E).all()
    assert "refused" in found.summary()
    assert np.isfinite(found.estimate.u).all()


def _exact_for_preset(losses):
    def changed(self, fields):
        exact = all(field is self.match.u for field in fields)
        return 0 * losses(self, fields) if exact else losses(self, fields)

    return changed


@pytest.mark.parametrize("better", [True, False])
def test_the_elastic_field_is_taken_where_it_predicts_better_than_test_6(
    monkeypatch, chosen, better
):
    I1, I2, _ = pair()
    monkeypatch.setattr(stiffness.Setup, "choose", lambda *_: (chosen, ""))
    monkeypatch.setattr(stiffness, "clearly_better", lambda a, b, clear: better)
    found = identify_stiffness(I1, I2, PLAIN)
    assert np.array_equal(found.estimate.u, found.elastic) == better
