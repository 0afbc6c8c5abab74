"""A virtual OCT experiment: two tomograms of a pressed sample whose motion is known.

The sample is filled with random scatterers that move with the true field. A tomogram is
the magnitude of the coherent sum of their echoes (Schmitt, Xiang and Yung, J. Biomed.
Opt. 4, 1999), each a Gaussian point-spread function whose phase is the way to the
scatterer and back. Speckle is then interference and nothing else: where the sample
strains, scatterers inside of a resolution cell change their relative phases, and it decorrelates.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eofm.errors import InputError
from eofm.grid import Array
from eofm.imaging.gaussian import gaussians
from eofm.imaging.splines import evaluate_field
from eofm.settings import VirtualOct

Complex = NDArray[np.complex128]

# Scatterers whose echoes are summed at once, and the widths of a Gaussian as it is cut off.
AT_ONCE = 2**17
REACH = 6.0
# Scatterers for each pixel beyond which a setting has the wrong unit.
DENSEST = 100


class Scatterers(NamedTuple):
    """Scatterers of the sample: the many of its matrix first, then the strong ones.

    Attributes
    ----------
    x : ndarray, shape (2, N)
        Places before compression, px from the corner of the sample.
    amplitude : ndarray, shape (N,)
        Of the echo without attenuation; the matrix's mean intensity is 1.
    """

    x: Array
    amplitude: Array


class Experiment(NamedTuple):
    """What ``make_tomograms`` returns, all in the region of interest, (height, width)."""

    I1: Array
    I2: Array
    truth: Array
    background: Array


def make_tomograms(u: Array, background: Array, settings: VirtualOct = VirtualOct()) -> Experiment:
    """Tomograms of the inside of a sample before and after a displacement.

    Parameters
    ----------
    u, background : ndarray, shape (2, height, width)
        The true displacement and the homogeneous background of the whole sample, px. Both
        are enlarged: a sample ``s`` times as large and compressed ``s`` times as far moves
        by ``s u(x / s)``, for linear elasticity knows no lengths.
    settings : VirtualOct
        Enlargement, region of interest, scatterers, microscope and noise.

    Returns
    -------
    Experiment
        Log-compressed images in [0, 1] before and after, and both fields, px.

    Raises
    ------
    InputError
        If the fields differ in size or the region of interest is too small for an image.

    Examples
    --------
    >>> import numpy as np
    >>> import eofm
    >>> u = np.zeros((2, 20, 30))
    >>> made = eofm.make_tomograms(u, u, eofm.VirtualOct(reflectors=50))
    >>> made.I1.shape == made.truth.shape[1:]
    True
    """
    if u.shape != background.shape:
        raise InputError(
            f"a true field of {u.shape[1:]} and a background of {background.shape[1:]} px differ"
            " in size; compute both for one sample"
        )
    whole = enlarged(u.shape[1:], settings.scale)
    rows, columns = region(whole, settings.margin)
    pixels = np.stack(np.meshgrid(columns, rows))
    truth, known = (motion(f, pixels, settings.scale) for f in (u, background))
    scatterers = fill(whole, settings)
    moved = scatterers._replace(x=scatterers.x + motion(u, scatterers.x, settings.scale))
    noise = np.random.default_rng([settings.seed, 2])
    I1, I2 = (
        compress(add_noise(echoes(s, rows, columns, settings), noise, settings), settings)
        for s in (scatterers, moved)
    )
    return Experiment(I1, I2, truth, known)


def enlarged(shape: tuple[int, ...], scale: float) -> tuple[int, int]:
    """Rows and columns of the enlarged sample."""
    height, width = (round(scale * (n - 1)) + 1 for n in shape)
    return height, width


def region(shape: tuple[int, int], margin: tuple[float, float]) -> tuple[Array, Array]:
    """Rows and columns of the region of interest, px from the corner of the sample.

    Raises
    ------
    InputError
        If it is narrower than 8 px.
    """
    cut = [int(np.ceil(m * (n - 1))) for m, n in zip(margin[::-1], shape, strict=True)]
    rows, columns = (np.arange(c, n - c, dtype=np.float64) for c, n in zip(cut, shape, strict=True))
    if min(len(rows), len(columns)) < 8:
        raise InputError(
            f"margin: leaves {len(rows)} x {len(columns)} px of a sample of {shape[0]} x"
            f" {shape[1]} px; at least 8 x 8 are needed for an image"
        )
    return rows, columns


def motion(u: Array, x: Array, scale: float) -> Array:
    """Displacement ``s u(x / s)`` of the enlarged sample at points of shape (2, ...), px."""
    return scale * evaluate_field(u, x / scale)


def fill(shape: tuple[int, int], settings: VirtualOct) -> Scatterers:
    """Weak scatterers everywhere and a few strong reflectors, at random places.

    Raises
    ------
    InputError
        If they are too many.
    """
    weak, strong = (np.random.default_rng([settings.seed, k]) for k in (0, 1))
    sides = np.array(shape[::-1]) - 1.0
    number = settings.density * sides.prod() / (np.pi * np.prod(widths(settings)))
    if number + settings.reflectors > DENSEST * sides.prod():
        raise InputError(
            f"density: makes {number + settings.reflectors:.3g} scatterers with the reflectors in a"
            f" sample of {sides.prod():.3g} px; check the units of density, pixel_size and"
            " resolutions"
        )
    count = round(number)
    x = weak.uniform(0, sides, (count, 2)), strong.uniform(0, sides, (settings.reflectors, 2))
    # By depth: what follows touches a few rows of the images at a time.
    x = x[0][np.argsort(x[0][:, 1], kind="stable")], x[1]
    # The mean intensity is then int |psf|^2 / (pi w1 w2) = 1.
    matrix = np.full(count, settings.density**-0.5)
    level = strong.uniform(*settings.reflector_level, settings.reflectors)
    return Scatterers(np.concatenate(x).T, np.concatenate([matrix, 10 ** (level / 20)]))


def widths(settings: VirtualOct) -> tuple[float, float]:
    """Lateral and axial ``w`` of the point-spread function ``exp(-x^2 / (2 w^2))``, px.

    The resolutions are full widths at half maximum of its square.
    """
    resolution = np.array([settings.lateral_resolution, settings.axial_resolution])
    w1, w2 = resolution / (2 * np.sqrt(np.log(2)) * settings.pixel_size)
    return float(w1), float(w2)


def echoes(scatterers: Scatterers, rows: Array, columns: Array, settings: VirtualOct) -> Complex:
    """Coherent sum of the echoes at the pixels, shape (height, width), free of noise.

    In units of the point-spread function's widths it is a round Gaussian.
    """
    w1, w2 = widths(settings)
    image = np.zeros((len(rows), len(columns)), dtype=np.complex128)
    for start in range(0, scatterers.x.shape[1], AT_ONCE):
        x1, x2 = scatterers.x[:, start : start + AT_ONCE]
        depth = x2 * settings.pixel_size
        phase = 4 * np.pi * settings.refractive_index / settings.wavelength * depth
        echo = scatterers.amplitude[start : start + AT_ONCE]
        echo = echo * np.exp(-settings.attenuation * depth / 1000)
        parts = np.stack([echo * np.cos(phase), echo * np.sin(phase)])
        seen = slice(*np.searchsorted(rows, [x2.min() - REACH * w2, x2.max() + REACH * w2]))
        centres = np.stack([x1 / w1, x2 / w2])
        real, imaginary = gaussians((columns / w1, rows[seen] / w2), centres, 1.0, parts)
        image[seen] += real + 1j * imaginary
    return image


def add_noise(A: Complex, rng: np.random.Generator, settings: VirtualOct) -> Complex:
    """Add shot noise of the reference arm, which is white and complex normal."""
    size = np.sqrt(settings.noise / 2)
    return A + size * (rng.normal(size=A.shape) + 1j * rng.normal(size=A.shape))


def compress(A: Complex, settings: VirtualOct) -> Array:
    """Intensity in dB, the ``display`` range of which becomes [0, 1]."""
    low, high = settings.display
    with np.errstate(divide="ignore"):
        level = 20 * np.log10(np.abs(A))
    return np.clip((level - low) / (high - low), 0, 1)
