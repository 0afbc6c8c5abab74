"""One grey scale for two images, pixels that show no sample, and intensities that fade."""

import logging
from functools import reduce
from typing import NamedTuple

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array, Mask, precision
from eofm.imaging.gaussian import blur
from eofm.imaging.sums import Terms, add_squares, resample
from eofm.settings import LARGEST, LEAST

# A highlight is so many times as high above the median as three in four local maxima are, which
# are the brightest of squares of PEAK px; and its surroundings, px, are none the better.
HIGHLIGHT, PEAK, MARGIN = 4.0, 5, 2
# Where there are more of them, that is what the sample looks like.
RARE = 0.05
# Length of a line of saturated pixels that no structure makes, px.
LINE = 32
# Speckle of linear intensity: sides of blocks, px; the contrast in them, whose theory is 0.52 for
# amplitudes and 1 for intensities; how fast it grows with their mean, which is not at all after a
# logarithm; and the range of the means, as a ratio: 15 dB.
BLOCK, CONTRAST, GROWTH, RANGE = 8, (0.4, 1.3), 0.75, 10 ** (15 / 20)
# Slices of a volume, and blocks, that suffice to tell.
SLICES, ENOUGH = 16, 64
# Numbers whose sums are taken at once.
CHUNK = 2**19
# What is said of it.
LINEAR = "looks like linear intensity, whose dark parts count little"

logger = logging.getLogger("eofm")


def normalise(
    I1: Array, I2: Array, limits: tuple[float, float] | None = None
) -> tuple[Array, Array]:
    """Map two images or volumes to [0, 1] by one affine map, so that brightness stays comparable.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width) or (depth, height, width)
        Before and after compression.
    limits : (low, high), optional
        Intensities that become 0 and 1; by default the extremes of both.

    Raises
    ------
    InputError
        If these are not two finite greyscale images or volumes of one size, or one is constant.
    """
    I1, I2 = (_real(I) for I in (I1, I2))
    if I1.ndim not in (2, 3) or I1.shape != I2.shape:
        kinds = {2: "greyscale images", 3: "volumes"}
        wanted = kinds.get(I1.ndim if I1.ndim == I2.ndim else 0, "greyscale images or volumes")
        raise InputError(f"wanted two {wanted} of one size, got shapes {I1.shape} and {I2.shape}")
    what = "an image" if I1.ndim == 2 else "a volume"
    extremes = [(float(I.min()), float(I.max())) for I in (I1, I2)]
    if not np.isfinite(extremes).all():
        raise InputError(f"{what} has NaN or infinite values; replace or crop them")
    for name, (low, high) in zip(("before", "after"), extremes, strict=True):
        if low == high:
            raise InputError(
                f"the {what.split()[1]} {name} compression is constant ({low:g}): there is no"
                " motion to see; check that the right file was given"
            )
    low, high = limits or (min(extremes)[0], max(high for _, high in extremes))
    if not LEAST <= high / 2 - low / 2 <= LARGEST:
        raise InputError(f"intensities from {low:g} to {high:g} are lost in rounding; scale them")
    return _scaled(I1, low, high), _scaled(I2, low, high)


def _real(I: Array) -> Array:
    """Numbers that are ordered."""
    if np.iscomplexobj(I):
        raise InputError("an image holds complex values; give their amplitude, abs(I)")
    I = np.asarray(I)
    return I if I.dtype.kind in "iuf" else np.asarray(I, dtype=np.float64)


def _scaled(I: Array, low: float, high: float) -> Array:
    # Integers would wrap around in their own differences.
    J = np.empty(I.shape, precision(I.ndim))
    np.subtract(I, low, out=J, dtype=np.float64, casting="same_kind")
    J /= high - low
    return J


def normalise_locally(I: Array, window: tuple[float, ...], spread: float | None = None) -> Array:
    """Remove the local mean of an image or a volume and divide by its local contrast.

    For pairs whose brightness changes from place to place. Means are Gaussian averages of
    standard deviations ``window`` = (lateral, axial, ...), in samples. Three local standard
    deviations fill half of [0, 1], and contrast is not raised where there is a tenth of
    the whole's or less, whose standard deviation is the ``spread`` if I is a part of it.
    """
    spread = I.std() if spread is None else spread
    deviation = blur(I, window)
    np.subtract(I, deviation, out=deviation)
    contrast = blur(deviation**2, window)
    contrast += float((0.1 * spread) ** 2)
    np.sqrt(contrast, out=contrast)
    contrast *= 6
    deviation /= contrast
    deviation += 0.5
    return deviation


class Levels(NamedTuple):
    """Intensities that tell pixels of the detector from those of the sample.

    Attributes
    ----------
    median : float
    highlight, top : float
        Heights above the median: of highlights, and of what saturates.
    """

    median: float
    highlight: float
    top: float

    @classmethod
    def of(cls, I: Array) -> "Levels | None":
        """Return those of an image or a volume; None if it has no peaks."""
        # Its import takes a tenth of a short estimate.
        from scipy import ndimage

        median = np.median(I)
        above = I - median
        peaks = above[(ndimage.maximum_filter(I, PEAK) <= I) & (above > 0)]
        if not peaks.size:
            return None
        highlight = HIGHLIGHT * np.quantile(peaks, 0.75)
        return cls(median, highlight, np.max(above, where=above <= highlight, initial=0.0))

    def marked(self, I: Array) -> Mask:
        """Pixels of highlights and saturated lines."""
        from scipy import ndimage

        above = I - self.median
        found = above > self.highlight
        top = (above >= self.top).view(np.uint8)
        for axis in range(I.ndim if np.count_nonzero(top) >= LINE else 0):
            # A line is what a segment of LINE pixels can cover: of an opening, both steps.
            starts = ndimage.minimum_filter1d(top, LINE, axis, mode="constant")
            lines = ndimage.maximum_filter1d(starts, LINE, axis, mode="constant", origin=-1)
            found |= lines.view(bool)
        return found


def defects(I: Array, levels: Levels | None = None) -> Mask:
    """Pixels that show the detector instead of the sample: highlights and saturated lines.

    Saturated pixels as such are none: what is clipped where it is bright moves with the
    sample. Neither is found where either would make up more than 5 % of the image or volume.
    Of a part of an image that has defects, the ``levels`` are those of the whole.
    """
    from scipy import ndimage

    own = levels or Levels.of(I)
    if own is None:
        return np.zeros(I.shape, dtype=bool)
    found = own.marked(I)
    if not found.any() or (levels is None and not found.mean() < RARE):
        return np.zeros_like(found)
    return ndimage.binary_dilation(found, iterations=MARGIN)


def looks_linear(I: Array) -> bool:
    """Whether an image or a volume shows speckle over a wide range, and no logarithm of it.

    From block to block, the standard deviation of speckle is proportional to its mean; that of its
    logarithm is the same everywhere (Goodman, Speckle Phenomena in Optics, 2007). Where the means
    reach over less than 15 dB, either will do, and the answer is no.
    """
    pages = I.reshape(-1, *I.shape[-2:])[:: max(1, len(I) // SLICES) if I.ndim == 3 else 1]
    rows, columns = (n // BLOCK for n in I.shape[-2:])
    if len(pages) * rows * columns < ENOUGH or I.min() < 0 or np.count_nonzero(I) < 0.99 * I.size:
        return False
    pages = pages[:, : rows * BLOCK, : columns * BLOCK].astype(np.float64)
    blocks = pages.reshape(len(pages), rows, BLOCK, columns, BLOCK)
    mean, deviation = blocks.mean(axis=(2, 4)).ravel(), blocks.std(axis=(2, 4)).ravel()
    mean, deviation = (f[(mean > 0) & (deviation > 0)] for f in (mean, deviation))
    low, high = np.quantile(mean, [0.05, 0.95]) if len(mean) >= ENOUGH else (1.0, 1.0)
    if high < RANGE * low:
        return False
    growth = np.polyfit(np.log(mean), np.log(deviation), 1)[0]
    return bool(growth > GROWTH and CONTRAST[0] < np.median(deviation / mean) < CONTRAST[1])


def advise_logarithm(I: Array) -> None:
    """Say so in the log where an image looks like linear intensity."""
    if looks_linear(I):
        logger.info(f"the first image {LINEAR}; try the logarithm, eofm sample --intensity log")


def filled(I: Array, dead: Mask) -> Array:
    """The image or volume with each dead pixel as its nearest live one."""
    if not dead.any() or dead.all():
        return I
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(dead, return_distances=False, return_indices=True)
    J = I.copy()
    J[dead] = I[tuple(k[dead] for k in nearest)]
    return J


class Window:
    """Gaussian averages over the pixels of a mask, of a ``width`` in samples.

    They are smooth, so sums over squares, or cubes, of a third of the width stand for the pixels.
    At an edge and beside dead zones the pixels that there are count.
    """

    def __init__(self, mask: Mask, width: float) -> None:
        self.mask, self.side = mask.astype(bool, copy=False), max(1, int(width // 3))
        self.terms = [_terms(n, self.side, width) for n in mask.shape]
        self.share = self._sum(np.ones(()))
        np.maximum(self.share, 1e-6, out=self.share)

    def mean(self, f: Array, *factors: Array) -> Array:
        """The average around each pixel of f, or of the product of several; of the mask's shape."""
        mean = self._sum(f, *factors)
        mean /= self.share
        return mean

    def _sum(self, *factors: Array) -> Array:
        shape, dtype = self.mask.shape, precision(self.mask.ndim)
        sums = np.empty([-(-n // self.side) for n in shape], dtype)
        # A few rows of squares at a time: products take no room.
        step = max(1, CHUNK * len(sums) // self.mask.size)
        for first in range(0, len(sums), step):
            some = slice(first * self.side, (first + step) * self.side)
            parts = (np.broadcast_to(f, shape)[some] for f in factors)
            product = reduce(np.multiply, parts).astype(dtype, copy=False)
            add_squares(sums[first : first + step], product, self.mask[some], self.side)
        J = np.empty(shape, dtype)
        resample(J, sums, self.terms)
        return J


def _terms(n: int, side: int, width: float) -> Terms:
    """Squares around each of n samples, and their weights."""
    count, reach = -(-n // side), int(np.ceil(4 * width / side))
    pixel = np.arange(n)[:, None]
    near = pixel // side + np.arange(-reach, reach + 1)
    at = near.clip(0, count - 1)
    centre = (at * side + np.minimum(at * side + side, n) - 1) / 2
    w = np.where(at == near, np.exp(-0.5 * ((pixel - centre) / width) ** 2), 0.0)
    return Terms(at, w)
