"""The elastic model with its derivatives, and the identified stiffness."""

import numpy as np
import pytest
from pressed import DISC, PLAIN, PRESSED, pair
from threadpoolctl import threadpool_info, threadpool_limits

from eofm.analysis.metrics import relative_errors
from eofm.elasticity.forward import displacement
from eofm.elasticity.sensitivity import Elastic
from eofm.errors import InputError
from eofm.flow.estimate import estimate_displacement
from eofm.flow.functional import Pointwise
from eofm.flow.known import Known
from eofm.identification import inversion
from eofm.identification.inversion import Problem
from eofm.identification.stiffness import identify_stiffness
from eofm.settings import Sample
from eofm.threads import serial

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("contact", ["clamped", "slip"])
@pytest.mark.parametrize("size", [(20, 33), (33, 20)])
def test_the_derivative_and_its_adjoint(contact, size):
    sample = Sample(height=size[0], width=size[1], contact=contact)
    motion = PRESSED | ({"left": np.zeros((2, 5))} if contact == "clamped" else {})
    model, rng = Elastic(sample, motion, 4.0, (0.9, 1.1)), np.random.default_rng(0)
    log_E, d = rng.normal(size=(2, *model.shape))
    state, e = model.solve(log_E), 1e-4
    forward, back = (model.to_pixels(model.solve(log_E + s * d).u) for s in (e, -e))
    du = state.derivative(d)
    assert np.abs((forward - back) / (2 * e) - du).max() < 1e-5 * np.abs(du).max()
    f = rng.normal(size=du.shape)
    assert np.isclose((du * f).sum(), (d * state.adjoint(f)).sum(), rtol=1e-9)


def test_the_elements_do_not_lock_and_converge():
    sample = PLAIN.changed(poisson_ratio=0.4995)
    reference = displacement(sample, 1.0)
    errors = []
    for cell in (4.0, 2.0):
        model = Elastic(sample, PRESSED, cell)
        u = model.to_pixels(model.solve(np.zeros(model.shape)).u)
        errors.append(relative_errors(u, reference)["e_rel"])
    assert errors[1] < 0.6
    assert errors[1] < 0.6 * errors[0]


def test_a_scaled_modulus_moves_nothing():
    model = Elastic(PLAIN, PRESSED, 4.0)
    one, four = (model.solve(np.full(model.shape, m)).u for m in (0.0, np.log(4)))
    assert np.allclose(one, four, atol=1e-10)


def test_the_step_goes_downhill():
    model, rng = Elastic(PLAIN, PRESSED, 4.0), np.random.default_rng(2)
    data = Pointwise(np.ones((3, *PLAIN.shape)) * np.reshape([1, 0, 1], (3, 1, 1)), pair()[2])
    problem = Problem(model, np.zeros((2, *PLAIN.shape)), data, 0.02)
    m = 0.1 * rng.normal(size=model.shape)
    state = problem.state(m)
    step = problem.improve(m, state, 0.1, damping=1.0)
    near = m + 1e-3 * step
    assert problem.cost(near, problem.state(near), 0.1) < problem.cost(m, state, 0.1)


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
    assert np.abs(np.log(found.E)).max() < 0.1
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


def test_unknown_edge_motion_is_refused():
    I1, I2, _ = pair()
    with pytest.raises(InputError, match="two edges that are known to move differently"):
        identify_stiffness(I1, I2, PLAIN, known=Known(edges={"top": np.zeros((2, 1))}))
    with pytest.raises(InputError, match="two edges that are known to move differently"):
        identify_stiffness(I1, I2, PLAIN.changed(compression=0.0))
    wrong = PLAIN.changed(compression=4.0)
    with pytest.raises(InputError, match=r"contradict .* raise the doubt"):
        identify_stiffness(I1, I2, wrong)


def test_images_of_another_size_are_refused():
    with pytest.raises(InputError, match="have to be the same"):
        identify_stiffness(np.ones((4, 4)), np.ones((4, 4)), PLAIN)


@pytest.mark.parametrize("stiff", [True, False])
def test_rough_fits_choose_the_weight_of_converged_ones(stiff, monkeypatch):
    chosen = []
    for compared in (inversion.COMPARED, 1.0):
        monkeypatch.setattr(inversion, "COMPARED", compared)
        chosen.append(identify_stiffness(*pair(stiff)[:2], PLAIN).gamma)
    assert chosen[0] == chosen[1]


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
