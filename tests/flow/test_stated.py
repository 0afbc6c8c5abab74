"""Edges whose motion is stated, all of it or a part, and what images say against it."""

import numpy as np
import pytest
from conftest import speckle

import eofm
from eofm.errors import InputError
from eofm.flow.functional import Pointwise, Quadratic, hold_edges
from eofm.flow.multigrid import multigrid
from eofm.grid import FACES, Grid
from eofm.imaging.splines import evaluate

SHAPE = (100, 132)
SLIDES = np.array([[np.nan], [0.0]])


def pressed(u, seed=1):
    """Dense speckle whose material moves by ``u``, shape (ndim, ...), of a bigger texture."""
    shape = u.shape[1:]
    big = speckle(tuple(n + 40 for n in shape), np.random.default_rng(seed))
    x = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij")[::-1])
    I1 = evaluate(big, x + u + 20.0)
    return I1, np.ascontiguousarray(big[(slice(20, -20),) * len(shape)])


def sliding(shape=SHAPE):
    """A sample between plates that move by 3 px and along which it slides: it gets wider."""
    x2, x1 = np.mgrid[: shape[0], : shape[1]].astype(float)
    return np.stack([0.03 * (x1 - shape[1] / 2) + 0.4, -3 * x2 / (shape[0] - 1)])


def estimated(images, known):
    return eofm.estimate_displacement(*images, known=eofm.Known(edges=known))


def plates(u1, by=-3.0):
    return {"top": np.array([[u1], [0.0]]), "bottom": np.array([[u1], [by]])}


def test_a_component_that_is_free_is_found_and_the_other_one_kept():
    u, known = sliding(), plates(np.nan)
    images = pressed(u)
    found = estimated(images, known)
    assert found.trust.verdict == "good"
    np.testing.assert_allclose(found.u[1, [0, -1]], u[1, [0, -1]], atol=1e-3)
    np.testing.assert_allclose(found.u[0], u[0], atol=0.03)
    bars = found.deviation(8)
    # Bars are averaged over some pixels beside the edge.
    assert bars[1, -1].mean() < 0.1 * bars[0, -1].mean()
    free = estimated(images, {}).u
    assert np.abs(found.u - u).mean() < np.abs(free - u).mean()


def test_an_edge_that_slides_and_was_said_to_stick_is_named_with_its_error():
    """Along it, what the images say against it is zero in the mean."""
    u = sliding()
    found = estimated(pressed(u), plates(0.4))
    assert found.trust.verdict == "doubtful"
    assert set(found.trust.edges) == {"top", "bottom"}
    wrong = np.sqrt(np.mean((u[0, -1] - 0.4) ** 2))
    # The field that knows no edge still leans on one that does.
    assert 0.5 * wrong < found.trust.edges["bottom"] < 1.1 * wrong
    assert all("contradict the motion that was stated" in reason for reason in found.trust.reasons)


@pytest.mark.parametrize(("by", "told"), [(-3.0, set()), (-3.4, {"bottom"}), (-5.5, {"bottom"})])
def test_a_plate_that_moved_by_another_amount_is_named(by, told):
    found = estimated(pressed(sliding()), plates(np.nan, by))
    assert set(found.trust.edges) == told
    assert (found.trust.verdict == "good") == (not told)


def test_noise_alone_contradicts_no_edge(rng):
    images = (I + rng.normal(0, 0.03, SHAPE) for I in pressed(sliding()))
    assert not estimated(images, plates(np.nan)).trust.edges


def test_an_edge_may_be_known_at_some_of_its_pixels():
    u = sliding()
    g = np.full((2, SHAPE[1]), np.nan)
    g[:, 50:90] = u[:, -1, 50:90]
    found = estimated(pressed(u), {"bottom": g})
    np.testing.assert_allclose(found.u[:, -1, 50:90], g[:, 50:90], atol=2e-3)
    assert found.trust.verdict == "good"


def test_a_face_of_a_volume_may_slide():
    shape = (24, 32, 40)
    x3, x2, x1 = np.mgrid[: shape[0], : shape[1], : shape[2]].astype(float)
    u = np.stack([0.02 * (x1 - 20), -1.2 * x2 / (shape[1] - 1), 0.02 * (x3 - 12)])
    images, g = pressed(u), np.full((3, 1, 1), np.nan)
    g[1] = -1.2
    found = estimated(images, {"bottom": g})
    np.testing.assert_allclose(found.u[1, :, -1], -1.2, atol=2e-3)
    np.testing.assert_allclose(found.u[0], u[0], atol=0.15)
    assert not found.trust.edges
    sticks = estimated(images, {"bottom": np.nan_to_num(g)})
    assert set(sticks.trust.edges) == {"bottom"}


def test_nothing_known_of_an_edge_is_refused():
    u = sliding()
    for wrong, message in (
        (np.full((2, 1), np.nan), "bottom: nothing of its motion is known"),
        (np.array([[np.inf], [0.0]]), "bottom: has NaN or infinite values"),
        (np.zeros((2, 7)), "bottom: wanted real numbers of shape"),
    ):
        with pytest.raises(InputError, match=message):
            estimated(pressed(u), {"bottom": wrong})


@pytest.mark.parametrize("shape", [(20, 33), (17, 16), (9, 12, 11)])
def test_a_firm_penalty_is_the_limit_of_exact_edges(shape, rng):
    """On all components the two are one problem; the multigrid has to bear the weight."""
    grid, n = Grid(shape), len(shape)
    g = rng.normal(size=(n, *shape))
    entries = [g[i] * g[j] for i in range(n) for j in range(i, n)]
    b, profile = rng.normal(size=(n, *shape)), rng.normal(size=(n, *FACES["top"].sides(shape)))
    terms, p = Pointwise(np.stack(entries), b), np.zeros((n, *shape))
    top = FACES["top"].pixels(n)
    free = np.ones(shape, dtype=bool)
    free[top], p[:, *top] = False, profile
    exact = p + multigrid(Quadratic(grid, terms, 0.8, free, "bending").shifted(p), tol=1e-9)
    held = Pointwise(terms.A.copy(), terms.b.copy())
    hold_edges(held, grid, {"top": profile}, 1e6)
    everywhere = np.ones(shape, dtype=bool)
    v = multigrid(Quadratic(grid, held, 0.8, everywhere, "bending"), tol=1e-9)
    np.testing.assert_allclose(v, exact, atol=1e-3)


def test_edges_that_alone_decide_are_no_reason_to_fail():
    """What is live are stripes, along which a motion is not seen."""
    x2 = np.mgrid[:48, :64][0].astype(float)
    I1, I2 = (0.5 + 0.5 * np.sin(x2 / 3 + shift) for shift in (0.0, 0.1))
    known = {edge: np.array([[0.2], [-0.3]]) for edge in ("left", "right")}
    dead = np.ones(x2.shape, dtype=bool)
    dead[10:30, 10:40] = False
    found = eofm.estimate_displacement(I1, I2, known=eofm.Known(edges=known, dead=dead))
    assert found.trust.verdict in ("good", "doubtful", "failed")
    np.testing.assert_allclose(found.u[:, :, 0], [[0.2] * 48, [-0.3] * 48], atol=1e-9)
