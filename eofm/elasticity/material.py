"""What a sample is made of."""

import numpy as np

from eofm.grid import Array
from eofm.settings import Sample


def modulus(sample: Sample, x: Array) -> Array:
    """Young's modulus at points ``x`` of shape (ndim, ...), relative to the background's.

    Inclusions are ellipses, or ellipsoids whose elevational radius is the mean of the others'
    logarithms.
    """
    E = np.ones(x.shape[1:])
    for part in sample.inclusions:
        square = (x[0] - part.x1) ** 2 / part.aspect + (x[1] - part.x2) ** 2 * part.aspect
        if part.x3 is not None:
            square += (x[2] - part.x3) ** 2
        E[square < part.radius**2] = part.stiffness
    return E


def lame(sample: Sample, x: Array) -> tuple[Array, Array]:
    """Lamé parameters (lambda, mu) at points ``x`` of shape (ndim, ...).

    In units of the background's Young modulus: only ratios matter where the boundary
    moves by a given displacement. Plane stress replaces lambda by
    ``2 lambda mu / (lambda + 2 mu)``.
    """
    E = modulus(sample, x)
    nu = sample.poisson_ratio
    mu = E / (2 * (1 + nu))
    if sample.plane == "stress":
        return E * nu / (1 - nu**2), mu
    return E * nu / ((1 + nu) * (1 - 2 * nu)), mu
