"""One grey scale for two images, local brightness and contrast, and intensities that fade."""

import logging
from functools import reduce

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array, Mask, precision
from eofm.imaging.gaussian import blur
from eofm.imaging.sampling import weights
from eofm.imaging.sums import Terms, add_squares, resample
from eofm.settings import LARGEST, LEAST

# Speckle of linear intensity: sides of blocks, px; the contrast in them, whose theory is 0.52 for
# amplitudes and 1 for intensities; how fast it grows with their mean, which is not at all after a
# logarithm; and the range of the means, as a ratio: 15 dB.
BLOCK, CONTRAST, GROWTH, RANGE = 8, (0.4, 1.3), 0.75, 10 ** (15 / 20)
# Smallest and largest differences of intensities in images and in volumes, whose squares are summed
# in single precision.
RANGES = {2: (LEAST, LARGEST), 3: (1e-15, 1e15)}
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
    I1, I2 = (real(I) for I in (I1, I2))
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
    least, largest = RANGES[I1.ndim]
    if not least <= high / 2 - low / 2 <= largest:
        raise InputError(f"intensities from {low:g} to {high:g} are lost in rounding; scale them")
    return _scaled(I1, low, high), _scaled(I2, low, high)


def real(I: Array) -> Array:
    """An image as an array of numbers to compute with.

    Raises
    ------
    InputError
        If its values are complex, masked or no numbers.
    """
    if np.iscomplexobj(I):
        raise InputError("an image holds complex values; give their amplitude, abs(I)")
    if np.ma.is_masked(I):
        raise InputError("an image has masked values; fill them, and give the mask as dead pixels")
    try:
        I = np.asarray(I)
        # Neither differences of large integers nor long numbers fit the kernels.
        plain = I.dtype.kind in "iuf" and I.dtype.itemsize < np.dtype(np.int64).itemsize
        return I if plain or I.dtype == np.float64 else I.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("an image holds something else than numbers; read it first") from error


def _scaled(I: Array, low: float, high: float) -> Array:
    """The image so that these are 0 and 1: itself if they are, for copies of volumes are large."""
    if (low, high) == (0.0, 1.0) and I.dtype == precision(I.ndim):
        return I
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


class Window:
    """Gaussian averages over the pixels of a mask, of a ``width`` in samples.

    They are smooth, so sums over squares, or cubes, of half of the width stand for the pixels;
    averages of these at nodes as far apart make a cubic B-spline, whose blur and that of the
    squares are parts of the width. At an edge and beside dead zones the pixels that there are
    count.
    """

    def __init__(self, mask: Mask, width: float) -> None:
        self.mask, self.side = mask.astype(bool, copy=False), max(1, int(width // 2))
        self.nodes = [_nodes(n, self.side, width) for n in mask.shape]
        self.pixels = [_pixels(n, self.side) for n in mask.shape]
        self.share = self._sum(np.ones(()))
        np.maximum(self.share, 1e-6, out=self.share)

    def mean(self, f: Array, *factors: Array) -> Array:
        """The average around each pixel of f, or of the product of several; of the mask's shape."""
        mean = self._sum(f, *factors)
        mean /= self.share
        return mean

    def trend(self, f: Array) -> Array:
        """The linear function of the place that is nearest to f on the mask, of its shape."""
        count, total = self._squares(np.ones(())), self._squares(f)
        # Squares' own numbers are their places.
        functions = [np.ones(()), *np.ogrid[*(slice(n) for n in count.shape)]]
        G = [[float((count * p * q).sum()) for q in functions] for p in functions]
        b = [float((total * p).sum()) for p in functions]
        a, *slopes = np.linalg.lstsq(np.array(G), np.array(b))[0]
        trend = np.full(f.shape, a, f.dtype)
        for k, slope in enumerate(slopes):
            x = (np.arange(f.shape[k]) - (self.side - 1) / 2) / self.side
            trend += (slope * x).astype(f.dtype).reshape(-1, *[1] * (f.ndim - 1 - k))
        return trend

    def _sum(self, *factors: Array) -> Array:
        sums, shape = self._squares(*factors), self.mask.shape
        smooth = np.empty([len(terms.at) for terms in self.nodes], sums.dtype)
        J = np.empty(shape, sums.dtype)
        resample(smooth, sums, self.nodes)
        resample(J, smooth, self.pixels)
        return J

    def _squares(self, *factors: Array) -> Array:
        """Sums of products over the mask's pixels in each square, or cube."""
        shape, dtype = self.mask.shape, precision(self.mask.ndim)
        sums = np.empty([-(-n // self.side) for n in shape], dtype)
        # A few rows of squares at a time: products take no room.
        step = max(1, CHUNK * len(sums) // self.mask.size)
        for first in range(0, len(sums), step):
            some = slice(first * self.side, (first + step) * self.side)
            parts = (np.broadcast_to(f, shape)[some] for f in factors)
            product = reduce(np.multiply, parts).astype(dtype, copy=False)
            add_squares(sums[first : first + step], product, self.mask[some], self.side)
        return sums


def _nodes(n: int, side: int, width: float) -> Terms:
    """Squares around each node, of which two lie beyond each end, and their weights."""
    count, std = -(-n // side), np.sqrt(width**2 - (side**2 - 1) / 12 - side**2 / 3)
    node, reach = np.arange(-2, count + 2)[:, None], int(np.ceil(4 * std / side))
    near = node + np.arange(-reach, reach + 1)
    at = near.clip(0, count - 1)
    centre = (at * side + np.minimum(at * side + side, n) - 1) / 2
    distance = node * side + (side - 1) / 2 - centre
    return Terms(at, np.where(at == near, np.exp(-0.5 * (distance / std) ** 2), 0.0))


def _pixels(n: int, side: int) -> Terms:
    """Nodes around each of n samples, and the weights of the B-spline."""
    first, t = np.divmod((np.arange(n) - (side - 1) / 2) / side, 1)
    return Terms(first.astype(np.intp)[:, None] + np.arange(1, 5), np.stack(weights(t)[0], axis=1))
