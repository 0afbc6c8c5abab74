"""Image pairs of known motion.

A scene is a way to make images, a motion and a seed. Bubbles move and are rendered again; textures
and photographs are the image after, and that before is what they are where it moved to. Nothing
is interpolated from an image that an estimate sees, but for photographs and real frames.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from textures import TEXTURES, Texture

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


Renderer = Callable[[Array, int], Scene]


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


def fast(shape: tuple[int, int]) -> Array:
    """Waves of 45 px, 1.2 px high."""
    x2, x1 = np.mgrid[: shape[0], : shape[1]] * (2 * np.pi / 45)
    return 1.2 * np.stack([np.sin(x1 + 1) * np.cos(x2), np.cos(x1) * np.sin(x2 + 2)])


def shear_band(shape: tuple[int, int]) -> Array:
    """The sample slides by 3 px across a band of 10 px (85 % of it), aslant."""
    x2, x1 = np.mgrid[: shape[0], : shape[1]]
    along = np.array([np.cos(0.3), np.sin(0.3)])
    across = -along[1] * (x1 - shape[1] / 2) + along[0] * (x2 - shape[0] / 2)
    return 1.5 * np.tanh(across / 4) * along[:, None, None]


# What is added to the smooth motion.
MOTIONS = {"fast": fast, "shear_band": shear_band}


def frame(image: Array, u: Array, seed: int) -> Scene:
    """A cut-out of a real frame, which is the image after; that before is sampled from it."""
    rng, shape = np.random.default_rng([seed, 1]), u.shape[1:]
    corner = [int(rng.integers(0, n - m + 1)) for n, m in zip(image.shape, shape, strict=True)]
    I2 = image[*(slice(c, c + n) for c, n in zip(corner, shape, strict=True))].astype(float)
    x = u + np.mgrid[: shape[0], : shape[1]][::-1]
    brightness = ndimage.gaussian_filter(I2, 8)
    # The frame goes on beyond the cut-out, and so does the sample.
    I1 = evaluate(image.astype(float), x + np.reshape(corner[::-1], (2, 1, 1)))
    low, high = I2.min(), I2.max()
    seen = inside(shape, x) & (brightness > np.median(brightness))
    return Scene((I1 - low) / (high - low), (I2 - low) / (high - low), u, seen)


def textured(texture: Callable[[np.random.Generator], Texture]) -> Renderer:
    """Images of a texture."""

    def render(u: Array, seed: int) -> Scene:
        at = texture(np.random.default_rng([seed, 5]))
        x = np.mgrid[: u.shape[1], : u.shape[2]][::-1].astype(float)
        return Scene(at(x + u), at(x), u, inside(u.shape[1:], x + u))

    return render


def dense(u: Array, seed: int) -> Scene:
    """Speckle: a sum of many Gaussian bubbles."""
    return _bubbles(u, 0.08, seed)


def sparse(u: Array, seed: int) -> Scene:
    """Bubbles as in the paper, 2 in 100 px."""
    return _bubbles(u, 0.02, seed)


def brightest(u: Array, seed: int) -> Scene:
    """Of bubbles that lie upon each other the brightest is seen."""
    rng, shape = np.random.default_rng([seed, 2]), u.shape[1:]
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


def coherent(u: Array, seed: int) -> Scene:
    """Speckle of interference, which decorrelates where the sample strains."""
    rng, shape = np.random.default_rng([seed, 3]), u.shape[1:]
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


def scattered(u: Array, seed: int) -> Scene:
    """Bubbles, 3 in 100 px, for motions that are large."""
    return _bubbles(u, 0.03, seed)


def _draw(
    shape: tuple[int, int], density: float, rng: np.random.Generator, margin: float = 8.0
) -> tuple[Array, Array, Array]:
    size = np.reshape(shape[::-1], (2, 1)) - 1.0
    count = int(density * np.prod(size + 2 * margin))
    x = rng.uniform(-margin, size + margin, (2, count))
    return x, rng.uniform(1.2, 1.8, count), rng.uniform(0.3, 1.0, count)


def _bubbles(u: Array, density: float, seed: int) -> Scene:
    rng, shape = np.random.default_rng([seed, 2]), u.shape[1:]
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


RENDERERS: dict[str, Renderer] = {
    "dense": dense,
    "sparse": sparse,
    "brightest": brightest,
    "coherent": coherent,
    **{name: textured(texture) for name, texture in TEXTURES.items()},
}
