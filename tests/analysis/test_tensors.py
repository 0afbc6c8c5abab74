import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eofm.analysis.strain import strain
from eofm.analysis.tensors import (
    MEASURES,
    SLAB,
    labels,
    maximum_shear,
    measured,
    pairs,
    principal,
    volume_change,
)

FINITE = [name for name in MEASURES if name != "small"]
SEEDS = st.integers(0, 2**20)


def rotation(n, rng):
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return Q if np.linalg.det(Q) > 0 else -Q if n == 3 else Q[::-1]


def stretched(n, rng):
    """A deformation gradient with its stretches, and the axes along which it stretches."""
    Q, stretches = rotation(n, rng), rng.uniform(0.6, 1.6, n)
    return Q @ np.diag(stretches) @ Q.T, stretches


def components(tensor):
    return np.array([tensor[i, j] for i, j in pairs(len(tensor))])


def gradient(F):
    return F - np.eye(len(F))


OF_STRETCH = {
    "small": lambda s: s - 1,
    "green-lagrange": lambda s: (s**2 - 1) / 2,
    "almansi": lambda s: (1 - s**-2) / 2,
    "hencky": np.log,
}


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize("n", [2, 3])
@given(SEEDS)
def test_principal_strains_are_those_of_the_stretches(measure, n, seed):
    F, stretches = stretched(n, np.random.default_rng(seed))
    found = principal(measured(gradient(F), measure)[:, None])[:, 0]
    expected = np.sort(OF_STRETCH[measure](stretches))[::-1]
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("measure", FINITE)
@pytest.mark.parametrize("n", [2, 3])
@given(SEEDS)
def test_a_rotation_afterwards_changes_nothing_or_turns_the_strain_with_it(measure, n, seed):
    rng = np.random.default_rng(seed)
    F, Q = stretched(n, rng)[0], rotation(n, rng)
    before, after = (measured(gradient(f), measure) for f in (F, Q @ F))
    if measure == "almansi":
        full = np.empty((n, n))
        for k, (i, j) in enumerate(pairs(n)):
            full[i, j] = full[j, i] = before[k]
        before = components(Q @ full @ Q.T)
    np.testing.assert_allclose(after, before, atol=1e-12)
    np.testing.assert_allclose(measured(gradient(Q), measure), 0, atol=1e-12)


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize("n", [2, 3])
@given(SEEDS)
def test_invariants_do_not_depend_on_the_axes(measure, n, seed):
    rng = np.random.default_rng(seed)
    F, Q = np.eye(n) + rng.uniform(-0.15, 0.15, (n, n)), rotation(n, rng)
    one, other = (measured(gradient(f), measure)[:, None] for f in (F, Q @ F @ Q.T))
    for of in (principal, maximum_shear, lambda e: volume_change(e, measure)):
        np.testing.assert_allclose(of(one), of(other), atol=1e-12)
    change = np.trace(F) - n if measure == "small" else np.linalg.det(F) - 1
    np.testing.assert_allclose(volume_change(one, measure), change, atol=1e-12)


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize("shape", [(31, 23), (9, 14, 11)])
def test_affine_motions_are_exact_up_to_the_edges(measure, shape, rng):
    """On pixels that are no squares and voxels that are no cubes, in the precision of each."""
    n = len(shape)
    G, size = rng.uniform(-0.2, 0.2, (n, n)), np.array([4.0, 2.5, 7.0])[:n]
    x = np.stack(np.indices(shape)[::-1]) * size.reshape(-1, *[1] * n)
    u = np.einsum("ij,j...->i...", G, x) / size.reshape(-1, *[1] * n) + 0.7
    e = strain(u, tuple(size), 12.0, measure)
    expected = measured(G, measure).reshape(-1, *[1] * n)
    np.testing.assert_allclose(
        e, np.broadcast_to(expected, e.shape), atol=1e-12 if n == 2 else 2e-6
    )


def test_steps_add_up_in_hencky_s_measure():
    step = np.diag([0.02, -0.1])
    twice = (np.eye(2) + step) @ (np.eye(2) + step) - np.eye(2)
    np.testing.assert_allclose(measured(twice, "hencky"), 2 * measured(step, "hencky"), atol=1e-14)


def test_shear_of_a_simple_shear():
    """A right angle that closes by 0.1 is a shear strain of 0.05, and the largest."""
    e = measured(np.array([[0, 0.1], [0, 0]]), "small")[:, None]
    np.testing.assert_allclose(e[2], 0.05)
    np.testing.assert_allclose(maximum_shear(e), 0.05)


@pytest.mark.parametrize("measure", FINITE)
def test_where_the_motion_folds_over_there_is_no_strain(measure):
    folded = np.stack([np.diag([-1.5, 0.0]), np.diag([0.1, 0.1]), np.diag([-1.0, 0])], axis=-1)
    e = measured(folded, measure)
    assert np.isnan(e[:, [0, 2]]).all()
    assert np.isfinite(e[:, 1]).all()
    assert np.isnan(principal(e)[:, 0]).all()
    assert np.isfinite(principal(e)[:, 1]).all()


def test_slabs_leave_no_seam(rng):
    G = rng.uniform(-0.1, 0.1, (3, 3, SLAB + 7))
    e = measured(G, "hencky")
    for k in (0, SLAB - 1, SLAB, SLAB + 6):
        np.testing.assert_array_equal(e[:, k], measured(G[..., [k]], "hencky")[:, 0])
        np.testing.assert_array_equal(principal(e)[:, k], principal(e[:, [k]])[:, 0])


def test_labels_say_the_axes():
    assert labels(2) == ["e11 lateral", "e22 axial", "e12 shear"]
    assert labels(3)[2:4] == ["e33 elevational", "e12 shear lateral-axial"]
