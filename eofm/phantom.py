"""The simulated sample: bubbles and their scattering images."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

def scatter(rng, shape, count, distance=0.0):
    height, width = shape
    return rng.uniform([[0], [0]], [[width - 1], [height - 1]], (2, count))

def render(shape, x, sigma, amplitude, base=0.0):
    x1 = np.arange(shape[1])[:, None]; x2 = np.arange(shape[0])[:, None]
    g1 = np.exp(-((x1 - x[0]) ** 2) / (2 * sigma**2))
    g2 = np.exp(-((x2 - x[1]) ** 2) / (2 * sigma**2))
    return base + (g2 * amplitude) @ g1.T
