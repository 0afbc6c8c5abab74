"""What happens to the images of a pair in a lab, beside the motion."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scenes import Scene
from scipy import ndimage

Array = NDArray[np.float64]

# Height and width of what lies upon the sample in the second image, px, and its brightness.
PATCH, DARK = (40, 60), 0.05


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


def _patch(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """A fold, a bubble of air, a shadow with hard edges."""
    corner = [int(rng.integers(0.2 * n, 0.5 * n)) for n in I2.shape]
    at = tuple(
        slice(c, c + min(p, n // 4)) for c, p, n in zip(corner, PATCH, I2.shape, strict=True)
    )
    I2 = I2.copy()
    I2[at] = I2.min() + DARK * (I2[at] - I2.min())
    return I1, I2


def _salt_and_pepper(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """One pixel in fifty, of each image another, is black or white."""

    def change(I: Array) -> Array:
        extremes = rng.choice([I.min(), I.max()], I.shape)
        return np.where(rng.random(I.shape) < 0.02, extremes, I)

    return change(I1), change(I2)


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


def _frame(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """A black frame, as scan conversion and registration leave one."""
    I1, I2 = I1.copy(), I2.copy()
    for I in (I1, I2):
        I[~_framed(I.shape)] = I1.min()
    return I1, I2


def _framed(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """What a frame of a twelfth of the sides leaves."""
    inner = np.zeros(shape, dtype=bool)
    inner[tuple(slice(n // 12, n - n // 12) for n in shape)] = True
    return inner


def _label(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Letters of a pixel's width at the top left, a scale bar at the bottom right."""
    I1, I2, top = I1.copy(), I2.copy(), max(I1.max(), I2.max())
    for I in (I1, I2):
        I[6:17, 8:58:5] = top
        I[6:17:5, 8:58] = top
        I[-14:-11, -50:-10] = top
    return I1, I2


def _lines(I1: Array, I2: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Columns of a detector that are brighter or darker than they should be, in both images."""
    lines = 0.5 * I1.std() * rng.normal(size=I1.shape[1])
    return I1 + lines, I2 + lines


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
    "dark_patch": _patch,
    "salt_and_pepper": _salt_and_pepper,
    "frame": _frame,
    "label": _label,
    "lines": _lines,
    "noise_5": _noise(0.05),
    "noise_10": _noise(0.10),
    "everything": _everything,
}


def under(scene: Scene, condition: str, seed: int) -> Scene:
    """The scene with its images changed by a condition."""
    rng = np.random.default_rng([seed, 4])
    I1, I2 = CONDITIONS[condition](scene.I1, scene.I2, rng)
    counted = scene.counted
    if condition == "frame":
        seen = _framed(counted.shape)
        x = np.mgrid[: counted.shape[0], : counted.shape[1]] + scene.u[::-1]
        counted = counted & seen & (ndimage.map_coordinates(seen.astype(float), x, order=1) == 1)
    return scene._replace(I1=I1, I2=I2, counted=counted)
