"""Motion of edges that is sought: smooth, about that of an estimate."""

import numpy as np
import scipy.sparse as sp

from eofm.elasticity.sensitivity import Elastic
from eofm.flow.estimate import Estimate
from eofm.grid import Array

# Distance of the nodes between which an edge moves linearly, px.
HATS = 7.0
# What the motion of an edge may be off by: some deviations of the estimate, and px.
DOUBT, UNKNOWN = 2.0, 0.02
SAMPLES = 8
# Distance over which what it is off by is alike, px: what an estimate gets wrong is smooth.
ALIKE = 14.0
# Modes with a smaller part of the variance of the largest are left out.
LEAST = 1e-3


def motions(model: Elastic, estimate: Estimate, h: Array) -> sp.csc_array:
    """Motions of the loose edges, one standard deviation each.

    Modes of a normal field along them whose covariance is ``d(x) d(y) (1 + r) exp(-r)``, with
    the doubt d of each place and ``r = sqrt(3) |x - y| / ALIKE`` (Matern's, of fields that have
    a slope). Edges whose places are free of each other would follow the noise of single bubbles,
    and the modulus with them.

    Parameters
    ----------
    model : Elastic
    estimate : Estimate
        Whose motion is the first guess.
    h : ndarray, shape (2, 1, 1)
        Sides of a pixel.

    Returns
    -------
    sparse matrix, shape (degrees of freedom, modes)
    """
    hats, nodes = model.hats(HATS)
    if not model.loose:
        return hats
    sides = zip(nodes, model.sample.shape, model.shape, strict=True)
    x2, x1 = (k * (n - 1) / e for k, n, e in sides)
    doubt = h * (DOUBT * estimate.deviation(SAMPLES) + UNKNOWN)
    i, j = np.round(x2).astype(int), np.round(x1).astype(int)
    x = h[:, 0] * np.stack([x1, x2])
    r = np.sqrt(3 * ((x[:, :, None] - x[:, None]) ** 2).sum(0)) / ALIKE
    variance, modes = np.linalg.eigh((1 + r) * np.exp(-r))
    kept = variance > LEAST * variance[-1]
    root = modes[:, kept] * np.sqrt(variance[kept])
    block = sp.block_diag([d[:, None] * root for d in doubt[:, i, j]])
    return (hats @ block).tocsc()
