"""Error bars: the same for the same seed, and as wide as the errors are."""

import numpy as np
from test_stiffness import PLAIN, pair

from eofm.stiffness import Identification, identify_stiffness
from eofm.uncertainty import deviations


def test_half_to_most_pixels_lie_within_one_standard_deviation():
    I1, I2, u = pair()
    found = identify_stiffness(I1, I2, PLAIN, settings=Identification(gamma=3.0))
    sd_u, sd_E = deviations(found, samples=16)
    assert np.array_equal(sd_u, deviations(found, samples=16)[0])
    assert sd_E.shape == PLAIN.shape
    assert (sd_E > 0).all()
    assert np.abs(sd_u[:, 0]).max() < 1e-9  # the top is held
    within = np.abs(found.u - u)[:, 1:-1] < sd_u[:, 1:-1]
    assert 0.4 < within.mean() < 0.9
