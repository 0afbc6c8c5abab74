"""Two volumes with a known motion, for the benchmark.

Dense speckle with noise that bulges as it is pressed, or the volumes and motions on which al-dvc
publishes its accuracy. Those are sampled from speckle that is known on a grid twice as fine, so
that neither volume is interpolated from the other.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from eofm import io
from eofm.settings import Phantom
from eofm.simulation.phantom import make_phantom

Array = NDArray[np.float64]

# Bubbles per voxel as far apart as those of the dense images, and the largest motion, voxels.
DENSITY, MOTION = 0.0226, 4.0
# Width of al-dvc's speckle, voxels; by how much the fine grid is finer, and its margin, voxels.
WIDTH, FINER, MARGIN = 2.0, 2, 12
# Signal to noise: the deviation of the speckle over that of the noise.
SIGNAL_TO_NOISE = 6.0
# Sides of al-dvc's volumes as parts of the longest one.
SIDES = 7 / 8, 15 / 16, 1
# Its affine motion (2 % of strain), and the amplitude and wavelength of its sinusoid, voxels.
GRADIENT = np.array([[0.02, 0.01, 0.0], [0.0, -0.015, 0.005], [0.003, 0.0, 0.01]])
SHIFT = 1.7, -0.4, 2.3
WAVE = 1.0, 80.0


def pressed(shape: tuple[int, ...]) -> Array:
    """A compression that bulges, with waves of a third of the volume."""
    x3, x2, x1 = (x / (n - 1) for x, n in zip(np.ogrid[*map(slice, shape)], shape, strict=True))
    wave = 0.05 * np.sin(6 * np.pi * x2) * np.cos(np.pi * x1) * np.cos(np.pi * x3)
    bulge = 0.5 * np.sin(np.pi * x2)
    parts = (x1 - 0.5) * bulge, wave - x2, (x3 - 0.5) * bulge
    return MOTION * np.stack([np.broadcast_to(part, shape) for part in parts])


def affine(x: Array) -> Array:
    """Motion at positions from the middle."""
    return np.einsum("ij,j...->i...", GRADIENT, x) + np.reshape(SHIFT, (3, 1, 1, 1))


def sinusoid(x: Array) -> Array:
    """Each component varies along the next axis."""
    amplitude, length = WAVE
    return amplitude * np.sin(2 * np.pi / length * x[[1, 2, 0]])


def sampled(case: str, shape: tuple[int, ...], seed: int) -> tuple[Array, Array, Array]:
    """Both volumes and the motion of a case of al-dvc."""
    place, grain = (np.random.default_rng([seed, k]) for k in range(2))
    fine = place.normal(size=[FINER * (n + 2 * MARGIN) for n in shape])
    fine = ndimage.gaussian_filter(fine, FINER * WIDTH, mode="wrap")
    fine /= fine.std()
    middle = np.reshape(shape[::-1], (3, 1, 1, 1)) / 2 - 0.5
    x = np.stack(np.mgrid[*map(slice, shape)][::-1]) - middle
    motion = sinusoid if case == "sinusoid" else affine
    before = x.copy()
    # What is at x came from where x - u leads.
    for _ in range(50):
        before = x - motion(before)
    at = FINER * ((before + middle)[::-1] + MARGIN)
    inner = tuple(slice(FINER * MARGIN, FINER * (MARGIN + n), FINER) for n in shape)
    volumes = fine[inner], ndimage.map_coordinates(fine, at, order=5, mode="grid-wrap")
    noise = 1 / SIGNAL_TO_NOISE if case == "noise" else 0.0
    I1, I2 = (I + grain.normal(0, noise, shape) for I in volumes)
    return I1, I2, motion(x)


case, size = snakemake.wildcards.case, int(snakemake.wildcards.size)
if case == "speckle":
    look = Phantom(
        count=round(DENSITY * size**3),
        sigma=(1.2, 1.8),
        brightness=(0.3, 1.0),
        noise=0.05,
        seed=snakemake.params.seed,
    )
    u = pressed((size,) * 3)
    I1, I2, _ = make_phantom(u, look)
else:
    shape = tuple(round(side * size) for side in SIDES)
    I1, I2, u = sampled(case, shape, snakemake.params.seed)
io.write_image(Path(snakemake.output.reference), I1)
io.write_image(Path(snakemake.output.deformed), I2)
io.write_field(Path(snakemake.output.truth), u)
