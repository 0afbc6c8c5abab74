"""The elastic model on elements, its derivatives, and edges whose motion is loose."""

import numpy as np
import pytest
from pressed import PLAIN, PRESSED

from eofm.analysis.metrics import relative_errors
from eofm.elasticity.forward import displacement
from eofm.elasticity.sensitivity import Elastic
from eofm.grid import FACES
from eofm.settings import Sample

LOOSE = ("left", "right", "top", "bottom")


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
    assert np.isclose((du * f).sum(), (d * state.adjoint(f)[0]).sum(), rtol=1e-9)


@pytest.mark.parametrize("size", [(20, 33), (33, 20)])
def test_the_derivative_by_the_motion_of_loose_edges_and_its_adjoint(size):
    rng = np.random.default_rng(1)
    sample = Sample(height=size[0], width=size[1])
    motion = {edge: np.zeros((2, 1)) for edge in LOOSE}
    model = Elastic(sample, motion, 4.0, loose=LOOSE)
    H, _ = model.hats(8.0)
    log_E, d = rng.normal(size=(2, *model.shape))
    c = rng.normal(size=H.shape[1])
    state = model.solve(log_E, H @ c)
    du = state.derivative(d, H @ c)
    # The displacement is linear in the motion of the edges.
    assert np.allclose(state.derivative(0 * d, H @ c), model.to_pixels(state.u), atol=1e-8)
    f = rng.normal(size=du.shape)
    back, more = state.adjoint(f)
    assert np.isclose((du * f).sum(), (d * back).sum() + c @ (H.T @ more), rtol=1e-9)


def test_hats_make_any_linear_motion_of_loose_edges_and_leave_known_ones():
    model = Elastic(PLAIN, {edge: np.zeros((2, 1)) for edge in LOOSE}, 4.0, loose=LOOSE)
    H, nodes = model.hats(9.0)
    q = nodes.shape[1]
    u = model.to_pixels(H @ np.r_[nodes[1], 2.0 * nodes[0]])
    columns, rows = np.linspace(0, model.shape[1], 76), np.linspace(0, model.shape[0], 48)
    assert H.shape[1] == 2 * q
    for edge in ("top", "bottom"):
        assert np.allclose(u[0][FACES[edge].pixels()], columns, atol=1e-9)
    for edge in ("left", "right"):
        assert np.allclose(u[1][FACES[edge].pixels()], 2 * rows, atol=1e-9)
    fixed = Elastic(PLAIN, {edge: np.zeros((2, 1)) for edge in LOOSE}, 4.0, loose=LOOSE[:3])
    H = fixed.hats(9.0)[0]
    u = fixed.to_pixels(H @ np.ones(H.shape[1]))
    assert np.abs(u[:, -1]).max() < 1e-12
    assert np.allclose(u[:, 0], 1)


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
