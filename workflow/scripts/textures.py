"""Images as functions of points: what moves is evaluated where it came from, never interpolated.

Each takes a random generator and returns a function of points, shape (2, ...) in px with the
lateral one first, whose values are about [0, 1].
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Texture = Callable[[Array], Array]

# Of octaves: wavelengths of the first, px; how many, and waves in each.
SHORTEST, OCTAVES, WAVES = 5.0, 5, 16
# Side of the squares that have a disc each, px.
CELL = 9.0
# Of layered speckle: waves, the size of a speckle, thickness of a layer, depth in which the light
# loses half of its amplitude, px; and the range of amplitudes that is shown, as a ratio.
SPECKLE_WAVES, SPECKLE, LAYER, HALF, SHOWN = 300, 1.6, 22.0, 60.0, 200.0


def octaves(rng: np.random.Generator) -> Texture:
    """Waves of random directions, as high as they are long: large structures, as in nature."""
    length = SHORTEST * 2 ** (np.arange(OCTAVES) + rng.uniform(size=(WAVES, OCTAVES))).ravel()
    turn, phase = rng.uniform(0, 2 * np.pi, (2, length.size))
    height = length / np.sqrt((length**2).sum() / 2)

    def texture(x: Array) -> Array:
        total = np.full(x.shape[1:], 0.5)
        for l, t, p, h in zip(length, turn, phase, height, strict=True):
            total += h / 5 * np.cos(2 * np.pi / l * (np.cos(t) * x[0] + np.sin(t) * x[1]) + p)
        return total

    return texture


def discs(rng: np.random.Generator) -> Texture:
    """Hard discs of different grey, one to a square; where they lie upon each other, the brightest.

    Their edges are a pixel wide, as a detector sees them.
    """
    table = rng.uniform(size=(64, 64, 4))

    def texture(x: Array) -> Array:
        cell, grey = np.floor(x / CELL).astype(int), np.zeros(x.shape[1:])
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                a, b, size, shade = np.moveaxis(table[cell[1] + j & 63, cell[0] + i & 63], -1, 0)
                middle = CELL * np.stack([cell[0] + i + a, cell[1] + j + b])
                within = CELL * (0.2 + 0.4 * size) - np.hypot(*(x - middle))
                grey = np.maximum(grey, shade * np.clip(within + 0.5, 0, 1))
        return grey

    return texture


def log_layers(rng: np.random.Generator) -> Texture:
    """Speckle of interference in layers below each other, less bright with depth; its logarithm."""
    k = rng.normal(0, 1 / SPECKLE, (2, SPECKLE_WAVES))
    wave = np.exp(2j * np.pi * rng.uniform(size=SPECKLE_WAVES)) / np.sqrt(SPECKLE_WAVES)
    bend, phase = rng.uniform(0.3, 1.0), rng.uniform(0, 2 * np.pi)
    bright = 10 ** rng.uniform(-1, 0, 64)

    def texture(x: Array) -> Array:
        field = np.zeros(x.shape[1:], complex)
        for (k1, k2), a in zip(k.T, wave, strict=True):
            field += a * np.exp(1j * (k1 * x[0] + k2 * x[1]))
        layer = (x[1] + 6 * np.sin(bend * x[0] / 20 + phase)) / LAYER
        # The border of two layers is as wide as a speckle.
        number, part = np.divmod(layer, 1)
        part = 1 / (1 + np.exp(-(part - 0.5) * LAYER / SPECKLE))
        number = number.astype(int)
        reflects = bright[number & 63] * (1 - part) + bright[number + 1 & 63] * part
        amplitude = np.abs(field) * reflects * 0.5 ** (x[1] / HALF)
        return 1 + np.log(np.clip(amplitude, 1 / SHOWN, None)) / np.log(SHOWN)

    return texture


TEXTURES = {"octaves": octaves, "discs": discs, "log_layers": log_layers}
# Photographs that scikit-image brings along, one for each half.
PHOTOS = {"photo": ("camera", "brick"), "ground": ("grass", "gravel")}
