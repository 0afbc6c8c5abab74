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
from eofm.grid import Array, componentwise, precision
from eofm.imaging.gaussian import gaussians
from eofm.imaging.splines import evaluate_field
from eofm.settings import Phantom

# Attempts per bubble before a distance is called impossible.
ATTEMPTS = 1000
# Where a bubble that is drawn alone ends, standard deviations.
CUT = 7.0


def make_phantom(u: Array, settings: Phantom = Phantom()) -> tuple[Array, Array, pd.DataFrame]:
    """Images or volumes of a sample before and after a displacement, and its bubbles.

    Parameters
    ----------
    u : ndarray, shape (2, height, width) or (3, depth, height, width)
        The true displacement, px.
    settings : Phantom
        Number, size, brightness and distance of the bubbles, how they look, noise and seed.

    Returns
    -------
    I1, I2 : ndarray, shape (height, width) or (depth, height, width)
        Images before and after compression.
    bubbles : DataFrame
        Columns x1, x2 (centres before), u1, u2 (displacements), sigma, all in px, and
        brightness; of a volume also x3 and u3.

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
    motion = evaluate_field(u, x).astype(np.float64)
    sigma = look.uniform(*settings.sigma, settings.count)
    brightness = look.uniform(*settings.brightness, settings.count)

    def image(centres: Array, strain: Array | None = None) -> Array:
        if settings.overlap == "sum" and strain is None:
            axes = [np.arange(n, dtype=np.float64) for n in shape[::-1]]
            I = gaussians(axes, centres, sigma, brightness[None])[0]
        else:
            add = np.add if settings.overlap == "sum" else np.maximum
            I = _stamped(shape, centres, sigma, brightness, strain, add)
        I += settings.base
        for part in [I] if I.ndim == 2 else I:  # noise has double precision
            part += noise.normal(0, settings.noise * brightness.max(), part.shape)
        return I

    columns = {f"x{k}": c for k, c in enumerate(x, 1)}
    columns |= {f"u{k}": c for k, c in enumerate(motion, 1)}
    bubbles = pd.DataFrame(columns | {"sigma": sigma, "brightness": brightness})
    return image(x), image(x + motion, _gradient(u, x) if settings.strained else None), bubbles


def _gradient(u: Array, x: Array) -> Array:
    """Derivatives d_j u_i of a field at points, shape (ndim, ndim, M), by central differences."""
    ends = componentwise(u.shape[:0:-1], 1) - 1
    columns = []
    for step in 0.5 * np.eye(len(u))[..., None]:
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
    I = np.zeros(shape, precision(len(shape)))
    for k, centre in enumerate(centres.T):
        half = CUT * sigma[k]
        box = tuple(
            slice(max(0, int(np.ceil(c - half))), max(0, min(n, int(c + half) + 1)))
            for c, n in zip(centre[::-1], shape, strict=True)
        )
        d = np.mgrid[box][::-1] - componentwise(centre, len(shape))
        if strain is not None:
            inverse = np.linalg.inv(np.eye(len(d)) + strain[:, :, k])
            d = np.einsum("ij,j...->i...", inverse, d)
        stamp = brightness[k] * np.exp(-(d**2).sum(0) / (2 * sigma[k] ** 2))
        I[box] = add(I[box], stamp)
    return I


def scatter(shape: tuple[int, ...], count: int, distance: float, rng: np.random.Generator) -> Array:
    """Uniformly distributed points at least ``distance`` px apart, shape (ndim, count).

    Raises
    ------
    InputError
        If there is no room left for a point.
    """
    upper = np.array(shape[::-1]) - 1.0
    if distance == 0:
        return rng.uniform(0, upper, (count, len(shape))).T.copy()
    points = np.empty((count, len(shape)))
    # Points by squares, or cubes, as wide as the distance: only those beside can be too near.
    side = max(distance, 1.0)
    squares: defaultdict[tuple[int, ...], list[Array]] = defaultdict(list)
    for i in range(count):
        for _ in range(ATTEMPTS):
            points[i] = rng.uniform(0, upper)
            square = tuple(int(c) for c in points[i] // side)
            beside = product(*(range(k - 1, k + 2) for k in square))
            near = [p for other in beside for p in squares.get(other, ())]
            if all(math.dist(points[i], p) >= distance for p in near):
                squares[square].append(points[i])
                break
        else:
            sides = " x ".join(str(n) for n in shape)
            raise InputError(
                f"found room for only {i} of {count} bubbles {distance:g} px apart in"
                f" {sides} px; lower their number or distance"
            )
    return points.T
