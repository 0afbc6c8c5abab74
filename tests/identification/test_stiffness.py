"""The identified stiffness of samples and of parts of them."""

from types import SimpleNamespace

import numpy as np
import pytest
from pressed import DISC, PLAIN, PRESSED, pair
from threadpoolctl import threadpool_info, threadpool_limits

from eofm.analysis.metrics import relative_errors
from eofm.elasticity.sensitivity import Elastic
from eofm.errors import InputError
from eofm.flow.estimate import estimate_displacement
from eofm.flow.known import Known
from eofm.grid import faces
from eofm.identification.edges import factor_of_motion
from eofm.identification.inversion import Inversion
from eofm.identification.stiffness import identify_stiffness
from eofm.settings import Identification
from eofm.threads import serial

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("loose", [(), ("left", "top")])
def test_the_step_goes_downhill(loose):
    motion = PRESSED | {edge: np.zeros((2, 1)) for edge in loose}
    model, rng = Elastic(PLAIN, motion, 4.0, loose=loose), np.random.default_rng(2)
    g, none = rng.normal(size=(2, *PLAIN.shape)), np.zeros((2, *PLAIN.shape))
    r = -(g * pair()[2]).sum(0)
    problem = Inversion(model, none, g, r, 0.02, 0.1 * model.hats(7.0)[0])
    z = problem.start(0.1 * rng.normal(size=model.shape))
    state = problem.state(z)
    step = problem.improve(z, state, 0.1, damping=1.0)
    near = z + 1e-3 * step
    assert problem.cost(near, problem.state(near), 0.1) < problem.cost(z, state, 0.1)


def test_relaxed_outlines_weigh_less_where_they_are_and_not_elsewhere():
    model = Elastic(PLAIN, PRESSED, 4.0)
    none = np.zeros((2, *PLAIN.shape))
    problem = Inversion(model, none, none, none[0], 0.02, model.hats(7.0)[0])
    m = np.zeros(model.shape)
    m[3:6, 4:9] = 1.0
    weights = problem.relaxed(problem.start(m)).weights.reshape(model.shape)
    assert (weights[:2] == 1).all()
    assert weights[2, 5] < 0.1


def overlap(E, shape=PLAIN.shape):
    x2, x1 = np.mgrid[: shape[0], : shape[1]]
    disc = (x1 - DISC.x1) ** 2 + (x2 - DISC.x2) ** 2 < DISC.radius**2
    outline = np.sqrt(DISC.stiffness) < E
    return 2 * (disc & outline).sum() / (disc.sum() + outline.sum())


def test_a_stiff_disc_is_found():
    I1, I2, u = pair()
    found = identify_stiffness(I1, I2, PLAIN)
    assert overlap(found.E) > 0.85
    assert relative_errors(found.estimate.u, u)["e_rel"] < 2.0
    assert found.scale == 1


def test_pixels_that_are_not_square_and_dead_zones():
    """Every second column of the images, seen as pixels twice as wide, and a dark corner."""
    I1, I2, u = pair()
    dead = np.zeros((48, 38), dtype=bool)
    dead[36:, 27:] = True
    half = PLAIN.changed(width=38)
    found = identify_stiffness(
        np.where(dead, 0.5, I1[:, ::2]),
        I2[:, ::2],
        half,
        known=Known(dead=dead, pixel_size=(2.0, 1.0)),
    )
    assert overlap(np.repeat(found.E, 2, axis=1)) > 0.65
    truth = u[:, :, ::2] * np.reshape([0.5, 1], (2, 1, 1))
    assert relative_errors(found.estimate.u, truth)["e_rel"] < 4.0


def test_a_homogeneous_sample_has_one_modulus():
    I1, I2, u = pair(stiff=False)
    found = identify_stiffness(I1, I2, PLAIN)
    assert not found.contrast
    assert "no significant contrast" in found.summary()
    assert np.abs(np.log(found.E)).max() < 0.01
    assert relative_errors(found.estimate.u, u)["e_rel"] < 0.5


@pytest.mark.parametrize("wrong", [1.9, 2.1])
def test_edges_that_move_otherwise_than_said_are_fitted(wrong):
    I1, I2, u = pair()
    said = PLAIN.changed(compression=wrong)
    found = identify_stiffness(I1, I2, said)
    assert found.scale * wrong == pytest.approx(2, rel=0.02)
    assert f"{found.scale:.3f}" in found.summary()
    free = estimate_displacement(I1, I2)
    errors = [relative_errors(v, u)["e_rel"] for v in (found.estimate.u, free.u)]
    assert errors[0] < errors[1]


@pytest.mark.parametrize(("error", "scale"), [(0.01, 0.94), (0.2, 1.0)])
def test_edges_are_scaled_where_the_images_ask_for_it_more_clearly_than_noise_would(error, scale):
    """The bottom seems to move by 1.88 px instead of 2, and one edge may be off by an error."""
    stated = pair()[2]
    wrong = np.zeros_like(stated)
    wrong[1, 24:] = error
    free = SimpleNamespace(u=0.94 * stated, samples=lambda count: [wrong, -wrong] * (count // 2))
    assert factor_of_motion(free, stated, PRESSED, Identification()) == pytest.approx(scale)


def test_edges_that_the_images_contradict_are_refused():
    I1, I2, _ = pair()
    wrong = PLAIN.changed(compression=4.0)
    with pytest.raises(InputError, match=r"contradict .* raise the doubt"):
        identify_stiffness(I1, I2, wrong)


def test_a_part_of_a_sample_shows_its_disc():
    """Nothing is known of its edges, and E is found up to a factor, or refused: bubbles are few."""
    part = np.s_[6:44, 10:62]
    sample = PLAIN.changed(height=38, width=52)
    x2, x1 = np.mgrid[part]
    disc = np.hypot(x1 - DISC.x1, x2 - DISC.x2) < DISC.radius
    kept = 0
    for seed in (1, 3, 5):
        I1, I2, u = pair(seed=seed)
        found = identify_stiffness(I1[part], I2[part], sample, known=Known(outside=tuple(faces(2))))
        assert found.fit.problem.model.loose == tuple(faces(2))
        alone = estimate_displacement(I1[part], I2[part])
        errors = [relative_errors(v, u[:, *part])["e_rel"] for v in (found.estimate.u, alone.u)]
        assert errors[0] < 1.1 * errors[1]
        if not found.refused:
            kept += 1
            assert 2.5 < np.median(found.E[disc]) / np.median(found.E[~disc]) < 8
    assert kept >= 2


def test_where_nothing_is_known_of_edges_their_motion_is_sought():
    known = Known(edges={"top": np.zeros((2, 1))})
    for seed in (6, 5):
        I1, I2, u = pair(stiff=False, seed=seed)
        found = identify_stiffness(I1, I2, PLAIN, known=known)
        assert found.fit.problem.model.loose == ("left", "right", "bottom")
        assert found.refused or not found.contrast or np.abs(np.log(found.E)).max() < 0.3
        alone = estimate_displacement(I1, I2, known=known)
        sought, without = (relative_errors(v, u)["e_rel"] for v in (found.estimate.u, alone.u))
        assert sought < 1.1 * without


def test_images_of_another_size_are_refused():
    with pytest.raises(InputError, match="have to be the same"):
        identify_stiffness(np.ones((4, 4)), np.ones((4, 4)), PLAIN)


def test_blas_takes_one_thread_and_its_own_number_afterwards():
    def threads():
        return {lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"}

    @serial
    def inner():
        return threads()

    @serial
    def outer():
        return inner() | threads()

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        assert outer() == {1}
        assert threads() == before
