"""The motion of edges that is sought: smooth, and as large as an estimate may be off."""

import numpy as np
import pytest
from pressed import PLAIN

from eofm.elasticity.sensitivity import Elastic
from eofm.identification.edges import ALIKE, DOUBT, UNKNOWN, motions

ZERO = np.zeros((2, 1))


class Doubted:
    """An estimate of which only its deviation is asked: lateral 0.1, axial 0.3 px."""

    @staticmethod
    def deviation(samples):
        return np.ones((2, *PLAIN.shape)) * np.reshape([0.1, 0.3], (2, 1, 1))


@pytest.fixture(scope="module")
def drawn():
    """Many motions as they may be of the top, whose neighbours are held, at its nodes."""
    model = Elastic(PLAIN, {"top": ZERO, "bottom": ZERO}, 4.0, loose=("top",))
    H = motions(model, Doubted, np.ones((2, 1, 1)))
    z = np.random.default_rng(1).normal(size=(H.shape[1], 4000))
    on = model._node_order[0]
    return np.stack([(H @ z)[2 * on + i] for i in (0, 1)]), model, H


def test_each_place_is_doubted_as_much_as_the_estimate(drawn):
    u, _, _ = drawn
    middle = u[:, u.shape[1] // 2 - 3 : u.shape[1] // 2 + 4].std(axis=(1, 2))
    assert middle == pytest.approx(DOUBT * np.array([0.1, 0.3]) + UNKNOWN, rel=0.12)


def test_neighbours_move_alike_and_far_places_do_not(drawn):
    u, model, _ = drawn
    r = np.corrcoef(u[1])
    step = round(ALIKE / 2 / model.sides[0])
    k = np.arange(len(r) - step)
    assert r[k, k + step].min() > 0.6
    far = round(4 * ALIKE / model.sides[0])
    assert abs(r[np.arange(len(r) - far), np.arange(far, len(r))]).max() < 0.15


def test_known_edges_stay(drawn):
    _, model, H = drawn
    bottom = model._node_order[-1]
    assert abs(H[2 * bottom]).max() == 0


def test_smooth_motions_are_fewer_than_places(drawn):
    _, model, H = drawn
    assert H.shape[1] <= model.hats(7.0)[0].shape[1]


def test_without_loose_edges_there_are_none():
    model = Elastic(PLAIN, {"top": ZERO, "bottom": ZERO}, 4.0)
    assert motions(model, Doubted, np.ones((2, 1, 1))).shape[1] == 0
