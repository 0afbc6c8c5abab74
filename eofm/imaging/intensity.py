"""One grey scale for two images, and pixels that show no sample."""

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array, Mask
from eofm.imaging import kernels
from eofm.imaging.gaussian import blur
from eofm.settings import LARGEST, LEAST

# A highlight is so many times as high above the median as three in four local maxima are, which
# are the brightest of squares of PEAK px; and its surroundings, px, are none the better.
HIGHLIGHT, PEAK, MARGIN = 4.0, 5, 2
# Where there are more of them, that is what the sample looks like.
RARE = 0.05
# Length of a line of saturated pixels that no structure makes, px.
LINE = 32


def normalise(
    I1: Array, I2: Array, limits: tuple[float, float] | None = None
) -> tuple[Array, Array]:
    """Map two images to [0, 1] by one affine map, so that brightness stays comparable.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width)
        Images before and after compression.
    limits : (low, high), optional
        Intensities that become 0 and 1; by default the extremes of both images.

    Raises
    ------
    InputError
        If these are not two finite greyscale images of one size, or one is constant.
    """
    if np.iscomplexobj(I1) or np.iscomplexobj(I2):
        raise InputError("an image holds complex values; give their amplitude, abs(I)")
    # Integers would wrap around in the differences below.
    I1, I2 = np.asarray(I1, dtype=np.float64), np.asarray(I2, dtype=np.float64)
    if I1.ndim != 2 or I1.shape != I2.shape:
        raise InputError(
            f"wanted two greyscale images of one size, got shapes {I1.shape} and {I2.shape}"
        )
    if not (np.isfinite(I1).all() and np.isfinite(I2).all()):
        raise InputError("an image has NaN or infinite values; replace or crop them")
    for name, I in (("before", I1), ("after", I2)):
        if I.min() == I.max():
            raise InputError(
                f"the image {name} compression is constant ({I.min():g}): there is no motion"
                " to see; check that the right file was given"
            )
    low, high = limits or (min(I1.min(), I2.min()), max(I1.max(), I2.max()))
    if not LEAST <= high / 2 - low / 2 <= LARGEST:
        raise InputError(f"intensities from {low:g} to {high:g} are lost in rounding; scale them")
    return (I1 - low) / (high - low), (I2 - low) / (high - low)


def normalise_locally(I: Array, window: tuple[float, float]) -> Array:
    """Remove the local mean of an image and divide by its local contrast.

    For pairs whose brightness changes from place to place. Means are Gaussian averages of
    standard deviations ``window`` = (lateral, axial), in samples. Three local standard
    deviations fill half of [0, 1], and contrast is not raised where there is a tenth of
    the image's or less.
    """
    deviation = I - blur(I, window)
    contrast = np.sqrt(blur(deviation**2, window) + (0.1 * I.std()) ** 2)
    return 0.5 + deviation / (6 * contrast)


def defects(I: Array) -> Mask:
    """Pixels that show the detector instead of the sample: highlights and saturated lines.

    Saturated pixels as such are none: what is clipped where it is bright moves with the
    sample. Neither is found where either would make up more than 5 % of the image.
    """
    # Its import takes a tenth of a short estimate.
    from scipy import ndimage

    above = I - np.median(I)
    peaks = above[(ndimage.maximum_filter(I, PEAK) <= I) & (above > 0)]
    if not peaks.size:
        return np.zeros(I.shape, dtype=bool)
    bright = above > HIGHLIGHT * np.quantile(peaks, 0.75)
    top = above >= np.max(above, where=~bright, initial=0.0)
    lines = [ndimage.binary_opening(top, np.ones(shape)) for shape in ((1, LINE), (LINE, 1))]
    found = bright | lines[0] | lines[1]
    if not 0 < found.mean() < RARE:
        return np.zeros_like(found)
    return ndimage.binary_dilation(found, iterations=MARGIN)


def filled(I: Array, dead: Mask) -> Array:
    """The image with each dead pixel as its nearest live one."""
    if not dead.any() or dead.all():
        return I
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(dead, return_distances=False, return_indices=True)
    return np.where(dead, I[tuple(nearest)], I)


class Window:
    """Gaussian averages over the pixels of a mask, of a ``width`` in samples.

    They are smooth, so sums over squares of a third of the width stand for the pixels. At an
    edge and beside dead zones the pixels that there are count.
    """

    def __init__(self, mask: Mask, width: float) -> None:
        self.mask, self.side = mask.astype(np.float64), max(1, int(width // 3))
        self.terms = [_terms(n, self.side, width) for n in mask.shape]
        self.share = np.maximum(self._sum(self.mask), 1e-6)

    def mean(self, f: Array) -> Array:
        """The average around each pixel, shape (height, width)."""
        return self._sum(f * self.mask) / self.share

    def _sum(self, f: Array) -> Array:
        for axis, n in enumerate(f.shape):
            f = np.add.reduceat(f, np.arange(0, n, self.side), axis=axis)
        axial, lateral = self.terms
        J = np.empty(self.mask.shape)
        kernels.resample(J, np.require(f, np.float64, ["C", "W"]), lateral, axial)
        return J


def _terms(n: int, side: int, width: float) -> kernels.Terms:
    """Squares around each of n samples, and their weights."""
    count, reach = -(-n // side), int(np.ceil(4 * width / side))
    pixel = np.arange(n)[:, None]
    near = pixel // side + np.arange(-reach, reach + 1)
    at = near.clip(0, count - 1)
    centre = (at * side + np.minimum(at * side + side, n) - 1) / 2
    w = np.where(at == near, np.exp(-0.5 * ((pixel - centre) / width) ** 2), 0.0)
    return kernels.Terms(at, w)
