"""The elastic model with its derivatives, and the identified stiffness."""

from functools import cache

import numpy as np
import pytest

from eofm.config import Forward, Inclusion, Phantom, Sample
from eofm.elasticity import displacement, true_field
from eofm.errors import InputError
from eofm.functional import Pointwise
from eofm.inversion import Identification, Problem
from eofm.metrics import relative_errors
from eofm.phantom import make_phantom
from eofm.preset import Preset
from eofm.sensitivity import Elastic
from eofm.stiffness import estimate_identified, identify_stiffness, known_sample

PLAIN = Sample(height=48, width=76, compression=2.0)
DISC = Inclusion(x1=32, x2=27, radius=11, stiffness=5)
DENSE = Phantom(count=1500, sigma=(1.3, 1.3), noise=0.02, seed=5)


@cache
def pair(stiff=True):
    sample = PLAIN.model_copy(update={"inclusions": (DISC,) if stiff else ()})
    u = true_field(sample, Forward(true_cell=2.0))
    return *make_phantom(u, DENSE)[:2], u


@pytest.mark.parametrize("contact", ["clamped", "slip"])
@pytest.mark.parametrize("size", [(20, 33), (33, 20)])
def test_the_derivative_and_its_adjoint(contact, size):
    sample = Sample(height=size[0], width=size[1], contact=contact, compression=1.5)
    model, rng = Elastic(sample, 4.0), np.random.default_rng(0)
    log_E, d = rng.normal(size=(2, *model.shape))
    state, e = model.solve(log_E), 1e-4
    forward, back = (model.to_pixels(model.solve(log_E + s * d).u) for s in (e, -e))
    du = state.derivative(d)
    assert np.abs((forward - back) / (2 * e) - du).max() < 1e-5 * np.abs(du).max()
    f = rng.normal(size=du.shape)
    assert np.isclose((du * f).sum(), (d * state.adjoint(f)).sum(), rtol=1e-9)


def test_the_elements_do_not_lock_and_converge():
    sample = PLAIN.model_copy(update={"poisson_ratio": 0.4995})
    reference = displacement(sample, 1.0)
    errors = []
    for cell in (4.0, 2.0):
        model = Elastic(sample, cell)
        u = model.to_pixels(model.solve(np.zeros(model.shape)).u)
        errors.append(relative_errors(u, reference)["e_rel"])
    assert errors[1] < 0.6
    assert errors[1] < 0.6 * errors[0]


def test_a_scaled_modulus_moves_nothing():
    model = Elastic(PLAIN, 4.0)
    one, four = (model.solve(np.full(model.shape, m)).u for m in (0.0, np.log(4)))
    assert np.allclose(one, four, atol=1e-10)


def test_the_step_goes_downhill():
    model, rng = Elastic(PLAIN, 4.0), np.random.default_rng(2)
    data = Pointwise(np.ones((3, *PLAIN.shape)) * np.reshape([1, 0, 1], (3, 1, 1)), pair()[2])
    problem = Problem(model, np.zeros((2, *PLAIN.shape)), data, 0.02)
    m = 0.1 * rng.normal(size=model.shape)
    state = problem.state(m)
    step = problem.improve(m, state, 0.1, damping=1.0)
    near = m + 1e-3 * step
    assert problem.cost(near, problem.state(near), 0.1) < problem.cost(m, state, 0.1)


def test_a_stiff_disc_is_found():
    I1, I2, u = pair()
    estimate, found = estimate_identified(I1, I2, PLAIN)
    x2, x1 = np.mgrid[: PLAIN.height, : PLAIN.width]
    disc = (x1 - DISC.x1) ** 2 + (x2 - DISC.x2) ** 2 < DISC.radius**2
    outline = np.sqrt(DISC.stiffness) < found.E
    assert 2 * (disc & outline).sum() / (disc.sum() + outline.sum()) > 0.85
    assert relative_errors(estimate.u, u)["e_rel"] < 2.0


def test_a_homogeneous_sample_has_one_modulus():
    I1, I2, u = pair(stiff=False)
    estimate, found = estimate_identified(I1, I2, PLAIN)
    assert np.abs(np.log(found.E)).max() < 0.1
    assert relative_errors(estimate.u, u)["e_rel"] < 0.5


def test_unknown_edge_motion_is_refused():
    I1, I2, _ = pair()
    with pytest.raises(InputError, match="motion of the top and of the bottom"):
        identify_stiffness(I1, I2, PLAIN, preset=Preset(zero_edges=("top",)))
    wrong = PLAIN.model_copy(update={"compression": 4.0})
    with pytest.raises(InputError, match="contradict"):
        known_sample(I1, I2, wrong, Identification(), Preset())
    fitted = known_sample(I1, I2, wrong, Identification(fit_compression=True), Preset())
    assert abs(fitted.compression - PLAIN.compression) < 0.05 * PLAIN.compression


def test_images_of_another_size_are_refused():
    with pytest.raises(InputError, match="have to be the same"):
        identify_stiffness(np.ones((4, 4)), np.ones((4, 4)), PLAIN, settings=Identification())
