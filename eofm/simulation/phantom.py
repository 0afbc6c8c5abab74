"""The simulated sample: bubbles at random places and their scattering images.

The image after compression is rendered from moved bubbles, never interpolated from the
image before: that would be an inverse crime.
"""

import math
from collections import defaultdict
from itertools import product

import numpy as np
import pandas as pd

from eofm.errors import InputError
from eofm.grid import Array
from eofm.imaging.gaussian import gaussians
from eofm.imaging.splines import evaluate_field
from eofm.settings import Phantom

# Attempts per bubble before a distance is called impossible.
ATTEMPTS = 1000
# Where a bubble that is drawn alone ends, standard deviations.
CUT = 7.0


def make_phantom(u: Array, settings: Phantom = Phantom()) -> tuple[Array, Array, pd.DataFrame]:
    """Images of a sample before and after a displacement, and its bubbles.

    Parameters
    ----------
    u : ndarray, shape (2, height, width)
        The true displacement, px.
    settings : Phantom
        Number, size, brightness and distance of the bubbles, how they look, noise and seed.

    Returns
    -------
    I1, I2 : ndarray, shape (height, width)
        Images before and after compression.
    bubbles : DataFrame
        Columns x1, x2 (centres before), u1, u2 (displacements), sigma, all in px, and
        brightness.

    Raises
    ------
    InputError
        If the bubbles do not fit into the sample at the distance wanted, or are too many.

    Examples
    --------
    >>> import numpy as np
    >>> import eofm
    >>> before, after, bubbles = eofm.make_phantom(np.zeros((2, 40, 60)), eofm.Phantom(count=50))
    >>> before.shape, len(bubbles), bool((before == after).all())
    ((40, 60), 50, True)
    """
    shape = u.shape[1:]
    if settings.count > math.prod(shape):
        raise InputError(
            f"count: {settings.count} bubbles are more than the image has pixels,"
            f" {shape[0]} x {shape[1]}"
        )
    place, look, noise = (np.random.default_rng([settings.seed, k]) for k in range(3))
    x = scatter(shape, settings.count, settings.distance, place)
    motion = evaluate_field(u, x)
    sigma = look.uniform(*settings.sigma, settings.count)
    brightness = look.uniform(*settings.brightness, settings.count)

    def image(centres: Array, strain: Array | None = None) -> Array:
        if settings.overlap == "sum" and strain is None:
            axes = [np.arange(n, dtype=np.float64) for n in shape[::-1]]
            I = gaussians(axes, centres, sigma, brightness[None])[0]
        else:
            add = np.add if settings.overlap == "sum" else np.maximum
            I = _stamped(shape, centres, sigma, brightness, strain, add)
        return settings.base + I + noise.normal(0, settings.noise * brightness.max(), shape)

    columns = {"x1": x[0], "x2": x[1], "u1": motion[0], "u2": motion[1]}
    bubbles = pd.DataFrame(columns | {"sigma": sigma, "brightness": brightness})
    return image(x), image(x + motion, _gradient(u, x) if settings.strained else None), bubbles


def _gradient(u: Array, x: Array) -> Array:
    """Derivatives d_j u_i of a field at points, shape (2, 2, M), by central differences."""
    steps = 0.5 * np.eye(2)[..., None]
    ends = np.reshape(u.shape[:0:-1], (2, 1)) - 1.0
    columns = []
    for step in steps:
        # The field is known inside of the image alone.
        far, near = np.clip(x + step, 0, ends), np.clip(x - step, 0, ends)
        rise = evaluate_field(u, far) - evaluate_field(u, near)
        columns.append(rise / (far - near).sum(0))
    return np.stack(columns, axis=1)


def _stamped(
    shape: tuple[int, ...],
    centres: Array,
    sigma: Array,
    brightness: Array,
    strain: Array | None,
    add: np.ufunc,
) -> Array:
    """Image of bubbles one by one, each deformed by ``1 + grad u`` at its place if given."""
    I = np.zeros(shape)
    for k, (c1, c2) in enumerate(centres.T):
        half = CUT * sigma[k]
        rows, columns = (
            slice(max(0, int(np.ceil(c - half))), max(0, min(n, int(c + half) + 1)))
            for c, n in ((c2, shape[0]), (c1, shape[1]))
        )
        x2, x1 = np.mgrid[rows, columns].astype(np.float64)
        d = np.stack([x1 - c1, x2 - c2])
        if strain is not None:
            d = np.einsum("ij,jkl->ikl", np.linalg.inv(np.eye(2) + strain[:, :, k]), d)
        stamp = brightness[k] * np.exp(-(d**2).sum(0) / (2 * sigma[k] ** 2))
        I[rows, columns] = add(I[rows, columns], stamp)
    return I


def scatter(shape: tuple[int, ...], count: int, distance: float, rng: np.random.Generator) -> Array:
    """Uniformly distributed points at least ``distance`` px apart, shape (2, count).

    Raises
    ------
    InputError
        If there is no room left for a point.
    """
    upper = np.array(shape[::-1]) - 1.0
    points = np.empty((count, 2))
    # Points by squares as wide as the distance: only those of nine can be too near.
    side = max(distance, 1.0)
    squares: defaultdict[tuple[int, int], list[Array]] = defaultdict(list)
    for i in range(count):
        for _ in range(ATTEMPTS):
            points[i] = rng.uniform(0, upper)
            if distance == 0:
                break
            column, row = (int(c) for c in points[i] // side)
            near = [
                p
                for square in product(range(column - 1, column + 2), range(row - 1, row + 2))
                for p in squares.get(square, ())
            ]
            if all(math.dist(points[i], p) >= distance for p in near):
                squares[column, row].append(points[i])
                break
        else:
            raise InputError(
                f"found room for only {i} of {count} bubbles {distance:g} px apart in"
                f" {shape[0]} x {shape[1]} px; lower their number or distance"
            )
    return points.T
