"""One grey scale for two images, and pixels that show no sample."""

from functools import reduce

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array, Mask, precision
from eofm.imaging.gaussian import blur
from eofm.imaging.sampling import weights
from eofm.imaging.sums import Terms, add_squares, resample
from eofm.settings import LARGEST, LEAST

# A highlight is so many times as high above the median as three in four local maxima are, which
# are the brightest of squares of PEAK px; and its surroundings, px, are none the better.
HIGHLIGHT, PEAK, MARGIN = 4.0, 5, 2
# Where there are more of them, that is what the sample looks like: of the whole, and of a Gaussian
# window of a width, px. The skin is as bright, in a scan that shows air above it.
RARE = 0.05
ISOLATED, NEIGHBOURHOOD = 0.02, 16.0
# Length of a line of saturated pixels that no structure makes, px, if not more than a part of the
# pixels that touch it is saturated: structures that are clipped are ragged.
LINE, RAGGED = 32, 0.25
# Numbers whose sums are taken at once.
CHUNK = 2**19


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


def normalise_locally(I: Array, window: tuple[float, ...]) -> Array:
    """Remove the local mean of an image or a volume and divide by its local contrast.

    For pairs whose brightness changes from place to place. Means are Gaussian averages of
    standard deviations ``window`` = (lateral, axial, ...), in samples. Three local standard
    deviations fill half of [0, 1], and contrast is not raised where there is a tenth of
    the whole's or less.
    """
    deviation = blur(I, window)
    np.subtract(I, deviation, out=deviation)
    contrast = blur(deviation**2, window)
    contrast += float((0.1 * I.std()) ** 2)
    np.sqrt(contrast, out=contrast)
    contrast *= 6
    deviation /= contrast
    deviation += 0.5
    return deviation


def defects(I: Array) -> Mask:
    """Pixels that show the detector instead of the sample: highlights and saturated lines.

    Saturated pixels as such are none: what is clipped where it is bright moves with the
    sample. Highlights stand alone, and neither is found where both would make up more than 5 % of
    the image or volume.
    """
    # Its import takes a tenth of a short estimate.
    from scipy import ndimage

    above = I - np.median(I)
    peaks = above[(ndimage.maximum_filter(I, PEAK) <= I) & (above > 0)]
    if not peaks.size:
        return np.zeros(I.shape, dtype=bool)
    found = above > HIGHLIGHT * np.quantile(peaks, 0.75)
    if found.any():
        share = Window(np.ones_like(found), NEIGHBOURHOOD).mean(found.astype(above.dtype))
        found &= share < ISOLATED
    top = (above >= np.max(above, where=~found, initial=0.0)).view(np.uint8)
    for axis in range(I.ndim if np.count_nonzero(top) >= LINE else 0):
        # A line is what a segment of LINE pixels can cover: of an opening, both steps.
        starts = ndimage.minimum_filter1d(top, LINE, axis, mode="constant")
        lines = ndimage.maximum_filter1d(starts, LINE, axis, mode="constant", origin=-1)
        found |= _smooth_edged(lines.view(bool), top.view(bool))
    if not 0 < found.mean() < RARE:
        return np.zeros_like(found)
    return ndimage.binary_dilation(found, iterations=MARGIN)


def _smooth_edged(lines: Mask, top: Mask) -> Mask:
    """Those of some lines that few pixels touch which are saturated as well."""
    from scipy import ndimage

    label, count = ndimage.label(lines, ndimage.generate_binary_structure(lines.ndim, lines.ndim))
    if not count:
        return lines
    wider = ndimage.maximum_filter(label, 3)
    wider[lines] = 0
    touching = np.bincount(wider.ravel(), minlength=count + 1)
    saturated = np.bincount(wider[top], minlength=count + 1)
    smooth: Mask = saturated <= RAGGED * touching
    smooth[0] = False
    return smooth[label]


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
        smooth, J = np.empty([len(terms.at) for terms in self.nodes], dtype), np.empty(shape, dtype)
        resample(smooth, sums, self.nodes)
        resample(J, smooth, self.pixels)
        return J


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
