"""One grey scale for two images."""

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array
from eofm.imaging.gaussian import blur
from eofm.settings import LARGEST, LEAST


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
