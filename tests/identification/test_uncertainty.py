"""Error bars: the same for the same seed, and as wide as the errors are."""

import numpy as np
import pytest
from pressed import PLAIN, pair

from eofm.flow.estimate import estimate_displacement
from eofm.identification.stiffness import identify_stiffness
from eofm.identification.uncertainty import deviations
from eofm.settings import Identification

pytestmark = pytest.mark.slow


def test_half_to_most_pixels_of_an_identified_sample_lie_within_one_standard_deviation():
    I1, I2, u = pair()
    found = identify_stiffness(I1, I2, PLAIN, Identification(gamma=3.0))
    sd_u, sd_E = deviations(found, samples=16)
    assert np.array_equal(sd_u, deviations(found, samples=16)[0])
    assert sd_E.shape == PLAIN.shape
    assert (sd_E > 0).all()
    assert np.abs(sd_u[:, 0]).max() < 1e-9  # the top is held
    within = np.abs(found.estimate.u - u)[:, 1:-1] < sd_u[:, 1:-1]
    assert 0.4 < within.mean() < 0.9


def test_the_same_of_an_estimate_from_images_alone():
    I1, I2, u = pair()
    found = estimate_displacement(I1, I2)
    sd = found.deviation(16)
    assert np.array_equal(sd, found.deviation(16))
    assert 0.5 < (np.abs(found.u - u) < sd).mean() < 0.85
