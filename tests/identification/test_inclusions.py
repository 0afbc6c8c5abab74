"""Inclusions with smooth outlines: their derivatives, and that they are found."""

from dataclasses import replace

import numpy as np
import pytest
from pressed import DISC, PLAIN, PRESSED, pair

from eofm.elasticity.forward import true_field
from eofm.elasticity.sensitivity import Elastic
from eofm.identification.inclusions import SIZE, Inclusions, no_inclusions, one_more, outline
from eofm.identification.inversion import LARGEST, Inversion
from eofm.identification.stiffness import identify_stiffness
from eofm.settings import Forward, Identification, Inclusion


def quiet(gamma, step, gain):
    """Nobody asks."""


SETTINGS = Identification(), quiet


def log_E(m):
    return LARGEST * np.tanh(m / LARGEST)


def seen(u, weight=1e4):
    """One component of a displacement as if it were seen at each pixel, to 0.01 px.

    The lateral one at every other pixel, like black squares on a board, the axial one between.
    """
    model = Elastic(PLAIN, PRESSED, 4.0)
    lateral = np.indices(PLAIN.shape).sum(0) % 2 == 0
    g = np.sqrt(weight) * np.stack([lateral, ~lateral])
    none = np.zeros((2, *PLAIN.shape))
    return Inversion(model, none, g, -(g * u).sum(0), 0.02, model.hats(7.0)[0])


def test_the_derivative_by_each_number():
    model = Elastic(PLAIN, PRESSED, 4.0)
    p = np.r_[32.0, 27.0, np.log(11), 1.5, 0.1 * np.random.default_rng(1).normal(size=SIZE - 4)]
    ((_, by),) = Inclusions(model, p[None]).parts
    h = 1e-5
    for k, row in enumerate(by):
        step = h * np.eye(SIZE)[k]
        after, before = (Inclusions(model, (p + d)[None]).parts[0][0] for d in (step, -step))
        assert row == pytest.approx((after - before) / (2 * h), abs=1e-6)


def test_what_images_ask_for_is_where_it_is_and_is_found():
    problem = seen(pair()[2])
    first, *_ = no_inclusions(problem, problem.start()).more(1)
    x1, x2, _, contrast, *_ = first.inclusions.p[0]
    assert np.hypot(x1 - DISC.x1, x2 - DISC.x2) < DISC.radius
    assert contrast > 0
    found = outline(first, *SETTINGS)
    x1, x2, size, contrast, *waves = found.inclusions.p[0]
    assert [x1, x2] == pytest.approx([DISC.x1, DISC.x2], abs=1.0)
    assert np.exp(size) == pytest.approx(DISC.radius, rel=0.1)
    assert log_E(contrast) == pytest.approx(np.log(DISC.stiffness), rel=0.15)
    assert np.abs(waves).max() < 0.1


def test_a_second_one_is_added_to_the_first():
    parts = (
        Inclusion(x1=20, x2=24, radius=9, stiffness=4),
        Inclusion(x1=55, x2=24, radius=9, stiffness=0.3),
    )
    u = true_field(PLAIN.changed(inclusions=parts), Forward(true_cell=2.0))
    found = no_inclusions(seen(u), seen(u).start())
    for _ in parts:
        found = one_more(found, 3, *SETTINGS)
    p = found.inclusions.p[np.argsort(found.inclusions.p[:, 0])]
    assert p[:, 0] == pytest.approx([20, 55], abs=1.5)
    assert log_E(p[:, 3]) == pytest.approx(np.log([4, 0.3]), rel=0.2)


def test_two_that_nearly_touch_are_cut():
    """Above each other: one long inclusion is found first."""
    parts = [Inclusion(x1=38, x2=x2, radius=8.5, stiffness=0.3) for x2 in (13, 33)]
    u = true_field(PLAIN.changed(inclusions=tuple(parts)), Forward(true_cell=2.0))
    model = Elastic(PLAIN, PRESSED, 4.0)
    p = np.r_[38, 23, np.log(11), -1.3, -0.9, np.zeros(SIZE - 5)]
    found = one_more(Inclusions(model, p[None]).on(seen(u)), 3, *SETTINGS)
    p = found.inclusions.p[np.argsort(found.inclusions.p[:, 1])]
    assert p[:, 1] == pytest.approx([13, 33], abs=1.5)
    assert p[:, 0] == pytest.approx([38, 38], abs=1.5)


def test_the_step_goes_downhill_along_all_numbers():
    problem = seen(pair()[2])
    found, *_ = no_inclusions(problem, problem.start()).more(1)
    state = problem.state(found.z)
    G = found.derivative(state)
    slope = 2 * G @ problem.left(state).ravel() + 2 * found.prior * found.values
    for k in range(4):
        d = 1e-4 * np.eye(len(G))[k]
        ends = [found.changed(sign * d) for sign in (1, -1)]
        costs = [end.cost(problem.state(end.z)) for end in ends]
        assert slope[k] == pytest.approx((costs[0] - costs[1]) / 2e-4, rel=0.01, abs=1.0)


@pytest.mark.slow
def test_error_bars_of_inclusions_hold_their_error():
    I1, I2, _ = pair()
    found = identify_stiffness(I1, I2, PLAIN)
    assert found.choice.prior.inclusions == 1
    x2, x1 = np.mgrid[: PLAIN.height, : PLAIN.width]
    disc = np.hypot(x1 - DISC.x1, x2 - DISC.x2) < 0.7 * DISC.radius
    deviation = found.errors.deviations(16, seed=0)[1]
    error = np.abs(np.log(found.E / DISC.stiffness))[disc]
    assert error.mean() < 2 * deviation[disc].mean()
    assert deviation[disc].mean() < 0.5
    again = replace(found).errors.deviations(16, seed=0)[1]
    assert np.array_equal(deviation, again)
