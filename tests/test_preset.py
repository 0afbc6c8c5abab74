"""The accurate estimate: splines, the choice of the weight, what it gains."""

import numpy as np
import pytest
from oracle import direct

from eofm.config import Phantom
from eofm.errors import InputError
from eofm.functional import Grid, Pointwise, Quadratic, bending_energy
from eofm.phantom import make_phantom
from eofm.preset import Preset, estimate_preset, held_out
from eofm.splines import Splines, spline_matrix

SHAPE = (40, 56)


def smooth_field(shape=SHAPE, size=1.5):
    x2, x1 = np.mgrid[: shape[0], : shape[1]] / np.reshape(shape, (2, 1, 1))
    return size * np.stack([0.6 * (x1 - 0.5) * np.sin(np.pi * x2), -x2 + 0.1 * np.sin(4 * x1)])


def speckle(u, **changes):
    settings = {"count": 400, "sigma": (1.3, 1.3), "seed": 3} | changes
    return make_phantom(u, Phantom(**settings))[:2]


def relative(estimate, truth):
    return np.linalg.norm(estimate - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize("n", [9, 40, 41])
def test_splines_hold_cubic_polynomials(n):
    B, x = spline_matrix(n, 1.0, 3.0), np.arange(n) / n
    values = x**3 - x
    assert np.abs(B @ np.linalg.lstsq(B.toarray(), values)[0] - values).max() < 1e-12


@pytest.mark.parametrize("shape", [(16, 21), (21, 16)])
def test_splines_with_a_knot_per_pixel_give_the_pixel_grid_minimum(shape):
    rng = np.random.default_rng(0)
    g, d = rng.normal(size=(2, *shape)), rng.normal(size=shape)
    terms = Pointwise(np.stack([g[0] ** 2, g[0] * g[1], g[1] ** 2]), d * g)
    grid, free = Grid(shape), np.ones(shape, dtype=bool)
    free[[0, -1]] = False
    pixels = direct(Quadratic(grid, terms, 2.0, free, "bending"))
    splines = Splines(grid, 1.0, ("top", "bottom")).minimise(terms, 2.0).v
    assert not splines[:, [0, -1]].any()
    assert relative(splines, pixels) < 0.02


def test_samples_have_the_posterior_covariance():
    grid = Grid((8, 8))
    rng = np.random.default_rng(1)
    terms = Pointwise(np.ones((3, 8, 8)) * np.reshape([2, 0.5, 1], (3, 1, 1)), np.zeros((2, 8, 8)))
    minimum = Splines(grid, 2.0).minimise(terms, 1.0)
    draws = np.stack([minimum.sample(rng) for _ in range(4000)])
    P = minimum.space.matrix.toarray()
    w = np.outer(*grid.weights).ravel()
    A = [[P.T @ (w[:, None] * a * P) for a in row] for row in ((2, 0.5), (0.5, 1))]
    R = P.T @ bending_energy(grid).toarray() @ P
    H = np.block([[A[0][0] + R, A[0][1]], [A[1][0], A[1][1] + R]])
    exact = np.diag(np.kron(np.eye(2), P) @ np.linalg.inv(H) @ np.kron(np.eye(2), P).T)
    assert np.allclose(draws.var(0).ravel(), exact, rtol=0.15)


def test_held_out_blocks_are_a_quarter_and_disjoint():
    folds = np.stack([held_out((64, 96), 8, k) for k in range(4)])
    assert (folds.sum(0) == 1).all()
    assert np.allclose(folds.mean((1, 2)), 0.25, atol=0.02)


def test_no_motion_gives_zero():
    I = speckle(np.zeros((2, *SHAPE)))[0]
    assert np.abs(estimate_preset(I, I).u).max() < 1e-9


def test_motion_is_found_without_edges_or_background():
    u = smooth_field()
    found = estimate_preset(*speckle(u))
    assert relative(found.u, u) < 0.06
    assert np.array_equal(found.u, estimate_preset(*speckle(u)).u)


def test_an_exact_background_stays():
    u = smooth_field()
    edges = ("top", "bottom", "left", "right")
    found = estimate_preset(*speckle(u), Preset(zero_edges=edges), background=u)
    assert relative(found.u, u) < 0.01
    assert np.array_equal(found.u[:, 0], u[:, 0])


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
def test_the_weight_chosen_is_near_the_best(noise):
    u = smooth_field()
    images = speckle(u, count=1500, noise=noise)
    weights = 10.0 ** np.arange(-1, 2.5, 0.5)
    errors = [relative(estimate_preset(*images, Preset(alpha=a)).u, u) for a in weights]
    assert relative(estimate_preset(*images).u, u) < 1.25 * min(errors)


def test_images_of_two_sizes_are_refused():
    with pytest.raises(InputError, match="differ in size"):
        estimate_preset(np.zeros((20, 20)), np.zeros((20, 21)))
