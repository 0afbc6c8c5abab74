import numpy as np
import pytest

from eofm.analysis.metrics import pixel_errors, relative_errors
from eofm.errors import InputError


def test_errors_of_a_scaled_field(rng):
    u = rng.normal(size=(2, 7, 9))
    found = relative_errors(1.1 * u, u)
    for name in ("e_rel", "e_rel_u1", "e_rel_u2"):
        assert found[name] == pytest.approx(10)
    assert found["max_error_u1"] == pytest.approx(0.1 * abs(u[0]).max())
    assert found["max_error_u2"] == pytest.approx(0.1 * abs(u[1]).max())


def test_components_are_told_apart():
    u = np.stack([np.full((3, 4), 3.0), np.full((3, 4), 4.0)])
    estimate = u + [[[1]], [[0]]]
    found = relative_errors(estimate, u)
    assert found["e_rel_u1"] == pytest.approx(100 / 3)
    assert found["e_rel_u2"] == 0
    assert found["e_rel"] == pytest.approx(20)


def test_exact_estimate_has_no_error(rng):
    u = rng.normal(size=(2, 3, 4))
    assert set(relative_errors(u, u).values()) == {0.0}


def test_zero_truth_is_refused():
    with pytest.raises(InputError, match="zero everywhere"):
        relative_errors(np.ones((2, 3, 4)), np.zeros((2, 3, 4)))


def test_errors_in_pixels():
    u = np.stack([np.full((3, 5), -7.0), np.full((3, 5), 4.0)])
    estimate = u + [[[3]], [[-4]]]
    estimate[0, 0, 0] -= 13
    assert pixel_errors(estimate, u) == {
        "max_error_u1": 10,
        "max_error_u2": 4,
        "median_error": 5,
        "max_true_u1": 7,
        "max_true_u2": 4,
    }


def test_volumes_add_a_third_component(rng):
    u = rng.normal(size=(3, 4, 5, 6)).astype(np.float32)
    estimate = u.copy()
    estimate[2] *= 1.5
    found = relative_errors(estimate, u)
    assert found["e_rel_u3"] == pytest.approx(50)
    assert found["e_rel_u1"] == 0
    assert found["e_rel"] == pytest.approx(50 * np.linalg.norm(u[2]) / np.linalg.norm(u))
    assert found["max_error_u3"] == pytest.approx(0.5 * abs(u[2]).max())
    errors = pixel_errors(estimate, u)
    assert errors["median_error"] == pytest.approx(0.5 * np.median(abs(u[2])))
    assert errors["max_true_u3"] == pytest.approx(abs(u[2]).max())
    assert list(errors)[:4] == ["max_error_u1", "max_error_u2", "max_error_u3", "median_error"]
