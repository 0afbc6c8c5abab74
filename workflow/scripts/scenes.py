"""Image pairs of known motion, and what happens to the second image of a pair in a lab.

A scene is a renderer and a seed: the renderer makes both images of a random smooth motion, and
a condition changes them. Nothing is interpolated from an image that an estimate sees, but for
real frames, of which there is one each.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from eofm.grid import inside
from eofm.imaging.gaussian import gaussians
from eofm.imaging.splines import evaluate, evaluate_field

Array = NDArray[np.float64]


class Scene(NamedTuple):
    """Images before and after, the true displacement, and where there is signal in both."""

    I1: Array
    I2: Array
    u: Array
    counted: NDArray[np.bool_]


def smooth_motion(shape: tuple[int, int], size: float, seed: int) -> Array:
    """A compression that bulges, and four waves, shape (2, height, width), px."""
    rng = np.random.default_rng([seed, 0])
    height, width = shape
    x2, x1 = np.mgrid[:height, :width].astype(float)
    depth, side = x2 / (height - 1), x1 / (width - 1) - 0.5
    u = size * np.stack([0.5 * side * np.sin(np.pi * depth), -depth])
    for _ in range(4):
        k = rng.normal(0, 1.0, 2)
        phase = 2 * np.pi * (k[0] * side + k[1] * depth + rng.uniform())
        u += 0.06 * size * rng.normal(size=(2, 1, 1)) * np.sin(phase)
    return u


def frame(image: Array, shape: tuple[int, int], size: float, seed: int) -> Scene:
    """A cut-out of a real frame, which is the image after; that before is sampled from it."""
    rng = np.random.default_rng([seed, 1])
    corner = [int(rng.integers(0, n - m + 1)) for n, m in zip(image.shape, shape, strict=True)]
    I2 = image[*(slice(c, c + n) for c, n in zip(corner, shape, strict=True))].astype(float)
    u = smooth_motion(shape, size, seed)
    x = u + np.mgrid[: shape[0], : shape[1]][::-1]
    counted = inside(shape, x)
    brightness = ndimage.gaussian_filter(I2, 8)
    # The frame goes on beyond the cut-out, and so does the sample.
    I1 = evaluate(image.astype(float), x + np.reshape(corner[::-1], (2, 1, 1)))
    low, high = I2.min(), I2.max()
    return Scene(
        (I1 - low) / (high - low),
        (I2 - low) / (high - low),
        u,
        counted & (brightness > np.median(brightness)),
    )


def dense(shape: tuple[int, int], size: float, seed: int) -> Scene:
    """Speckle: a sum of many Gaussian bubbles."""
    return _bubbles(shape, smooth_motion(shape, size, seed), 0.08, seed)


def sparse(shape: tuple[int, int], size: float, seed: int) -> Scene:
    """Bubbles as in the paper, 2 in 100 px."""
    return _bubbles(shape, smooth_motion(shape, size, seed), 0.02, seed)


def brightest(shape: tuple[int, int], size: float, seed: int) -> Scene:
    """Of bubbles that lie upon each other the brightest is seen."""
    rng = np.random.default_rng([seed, 2])
    u = smooth_motion(shape, size, seed)
    x, sigma, height = _draw(shape, 0.03, rng)
    images = []
    for at in (x, x + evaluate_field(u, x)):
        I = np.zeros(shape)
        for (x1, x2), s, h in zip(at.T, sigma, height, strict=True):
            rows, columns = (
                slice(max(0, int(c - 6 * s)), max(0, int(c + 6 * s) + 2)) for c in (x2, x1)
            )
            y2, y1 = np.ogrid[: shape[0], : shape[1]]
            part = np.exp(-((y2[rows] - x2) ** 2 + (y1[:, columns] - x1) ** 2) / (2 * s**2))
            I[rows, columns] = np.maximum(I[rows, columns], h * part)
        images.append(I)
    return _scene(*images, u)


def coherent(shape: tuple[int, int], size: float, seed: int) -> Scene:
    """Speckle of interference, which decorrelates where the sample strains."""
    rng = np.random.default_rng([seed, 3])
    u = smooth_motion(shape, size, seed)
    count = int(0.9 * np.prod(shape))
    x = rng.uniform(-8, np.reshape(shape[::-1], (2, 1)) + 7.0, (2, count))
    moved = x + evaluate_field(u, x)
    axes = tuple(np.arange(n, dtype=float) for n in shape[::-1])
    images = []
    # The phase turns by far less than 2 pi per px: as if the motion's carrier were removed.
    start, k = rng.uniform(0, 2 * np.pi, count), 2 * np.pi / 40
    for at in (x, moved):
        phase = start + k * at[1]
        re, im = gaussians(axes, at, 1.6, np.stack([np.cos(phase), np.sin(phase)]))
        images.append(np.hypot(re, im))
    return _scene(*images, u)


def rigid(shape: tuple[int, int], u: Array, density: float, seed: int) -> Scene:
    """Bubbles that move by any field."""
    return _bubbles(shape, u, density, seed)


def _draw(
    shape: tuple[int, int], density: float, rng: np.random.Generator, margin: float = 8.0
) -> tuple[Array, Array, Array]:
    size = np.reshape(shape[::-1], (2, 1)) - 1.0
    count = int(density * np.prod(size + 2 * margin))
    x = rng.uniform(-margin, size + margin, (2, count))
    return x, rng.uniform(1.2, 1.8, count), rng.uniform(0.3, 1.0, count)


def _bubbles(shape: tuple[int, int], u: Array, density: float, seed: int) -> Scene:
    rng = np.random.default_rng([seed, 2])
    # Bubbles that move in come from as far as the motion goes.
    x, sigma, height = _draw(shape, density, rng, 8.0 + np.abs(u).max())
    axes = tuple(np.arange(n, dtype=float) for n in shape[::-1])
    images = (gaussians(axes, at, sigma, height[None])[0] for at in (x, x + _beyond(u, x)))
    return _scene(*images, u)


def _beyond(u: Array, x: Array) -> Array:
    """A field at points, and at those outside of it its value at the border."""
    last = np.reshape(u.shape[:0:-1], (2, 1)) - 1.0
    return evaluate_field(u, np.clip(x, 0, last))


def _scene(I1: Array, I2: Array, u: Array) -> Scene:
    shape = I1.shape
    counted = inside(shape, u + np.mgrid[: shape[0], : shape[1]][::-1])
    top = max(I1.max(), I2.max())
    return Scene(I1 / top, I2 / top, u, counted)


def _none(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    return I1, I2


def _ramp(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    return I1, I2 * np.linspace(1.1, 0.4, len(I2))[:, None]


def _shadow(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    (n, m), top, at = I2.shape, rng.uniform(0.1, 0.4), rng.uniform(0.3, 0.7)
    x2, x1 = np.linspace(0, 1, n)[:, None], np.linspace(0, 1, m)
    below = 1 / (1 + np.exp(-(x2 - top) * n / 4))
    return I1, I2 * (1 - 0.6 * below * np.exp(-(((x1 - at) / 0.12) ** 2)))


def _gain(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    return I1, 0.7 * I2


def _offset(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    return I1, 0.7 * I2 + 0.15


def _spots(shape: tuple[int, ...], rng: np.random.Generator, count: int = 12) -> Array:
    spots = np.zeros(shape)
    for _ in range(count):
        i, j = (int(rng.integers(2, n - 4)) for n in shape)
        spots[i : i + rng.integers(1, 4), j : j + rng.integers(1, 4)] = rng.uniform(3, 6)
    return spots


def _appear(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    return I1, np.maximum(I2, _spots(I2.shape, rng))


def _stay(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    spots = _spots(I2.shape, rng)
    return np.maximum(I1, spots), np.maximum(I2, spots)


def _gamma(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    return I1, np.sqrt(np.clip(I2, 0, None))


def _decorrelate(strength: float) -> Callable[..., tuple[Array, Array]]:
    """Speckle of other bubbles, as coarse as the image's, that multiplies it."""

    def change(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        speckle = ndimage.gaussian_filter(rng.normal(size=I2.shape), 1.3)
        return I1, I2 * np.clip(1 + strength * speckle / speckle.std(), 0, None)

    return change


def _row(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    I1, I2, at = I1.copy(), I2.copy(), int(rng.integers(len(I1) // 4, len(I1) // 2))
    for I in (I1, I2):
        I[at : at + 2] = 1.0
    return I1, I2


def _noise(strength: float) -> Callable[..., tuple[Array, Array]]:
    """White noise, as a part of the images' range (its 99.5th percentile)."""

    def change(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        top = strength * np.percentile(I1, 99.5)
        return I1 + top * rng.normal(size=I1.shape), I2 + top * rng.normal(size=I2.shape)

    return change


def _everything(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    for change in (_decorrelate(0.2), _ramp, _offset, _appear, _noise(0.03)):
        I1, I2 = change(I1, I2, rng)
    return I1, I2


CONDITIONS: dict[str, Callable[..., tuple[Array, Array]]] = {
    "none": _none,
    "ramp": _ramp,
    "shadow": _shadow,
    "gain": _gain,
    "gain_offset": _offset,
    "highlights_appear": _appear,
    "highlights_stay": _stay,
    "gamma": _gamma,
    "decorrelated_weak": _decorrelate(0.2),
    "decorrelated_strong": _decorrelate(0.4),
    "saturated_row": _row,
    "noise_5": _noise(0.05),
    "noise_10": _noise(0.10),
    "everything": _everything,
}


def under(scene: Scene, condition: str, seed: int) -> Scene:
    """The scene with its images changed by a condition."""
    rng = np.random.default_rng([seed, 4])
    I1, I2 = CONDITIONS[condition](scene.I1, scene.I2, rng)
    return scene._replace(I1=I1, I2=I2)


def large_motions(shape: tuple[int, int]) -> dict[str, Array]:
    """Motions that a start has to find: compressions and shifts of 20 to 80 px in 512, a turn."""
    n = min(shape)
    x = np.mgrid[: shape[0], : shape[1]][::-1].astype(float)
    x -= np.reshape(shape[::-1], (2, 1, 1)) / 2 - 0.5
    turn = np.deg2rad(10)
    c, s = np.cos(turn) - 1, np.sin(turn)
    fields = {"turn_10": np.stack([c * x[0] - s * x[1], s * x[0] + c * x[1]])}
    for px in (20, 40, 80):
        size = px * n / 512
        depth = 0.5 + x[1] / shape[0]
        fields[f"press_{px}"] = size * np.stack(
            [0.2 * np.sin(np.pi * x[0] / shape[1]) * np.sin(np.pi * depth), -depth]
        )
        fields[f"shift_{px}"] = np.stack([0.6 * size + 0 * x[0], -0.8 * size + 0 * x[1]])
    return fields


RENDERERS = {"dense": dense, "sparse": sparse, "brightest": brightest, "coherent": coherent}
