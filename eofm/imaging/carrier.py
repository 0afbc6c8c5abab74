"""Images that oscillate, as radio-frequency lines of ultrasound do: the carrier and its amplitude.

Such an image is grey on coarse scales, and looks nearly the same after a motion of one period. Its
amplitude, which is what a B-scan shows, is seen on all of them.
"""

from functools import reduce

import numpy as np
from scipy import fft

from eofm.grid import Array, precision

# Sides of the middle of an image, and of a volume, that suffice to tell.
MIDDLE = {2: 512, 3: 96}
# Width of the rings of a spectrum, in waves across the shortest side; and the power of those of
# up to a third of the carrier's frequency at most, as a part of the power of the carrier's.
WIDTH, LOW = 2, 0.15


def has_carrier(I: Array) -> bool:
    """Whether an image or a volume oscillates, so that coarse scales show next to nothing of it.

    Then its power, averaged over all directions, has a maximum with little below a third of that
    frequency. Waves nearly as long as the image do not count: brightness may change.
    """
    sides = (min(n, MIDDLE[I.ndim]) for n in I.shape)
    J = I[*(slice((n - s) // 2, (n + s) // 2) for n, s in zip(I.shape, sides, strict=True))]
    J = (J - J.mean()).astype(precision(I.ndim), copy=False)
    for axis, n in enumerate(J.shape):
        window = np.hanning(n + 2)[1:-1].astype(J.dtype)
        J *= window.reshape(-1, *[1] * (J.ndim - 1 - axis))
    power = np.abs(fft.rfftn(J, overwrite_x=True)).ravel() ** 2
    rings = min(J.shape) // (2 * WIDTH)
    ring = (2 * rings * _length(_frequencies(J))).astype(np.intp).ravel()
    total, count = (np.bincount(ring, w)[1:rings] for w in (power, None))
    if len(total) < 2:
        return False
    density = total / count
    top = int(density.argmax())
    below = density[: (top + 1) // 3]
    return below.size > 0 and bool(below.max() < LOW * density[top])


def amplitude(I: Array) -> Array:
    """Local amplitude of what oscillates about the mean, in whatever direction.

    That of the monogenic signal (Felsberg and Sommer, IEEE Trans. Signal Process. 49, 2001): the
    image and its Riesz transforms, one for each axis. Of waves along one axis it is the envelope.
    """
    J = I - I.mean()
    spectrum, squares = fft.rfftn(J), J**2
    frequencies = _frequencies(I)
    length = _length(frequencies)
    length[(0,) * I.ndim] = 1
    spectrum *= -1j / length
    for k in frequencies:
        squares += fft.irfftn(k * spectrum, I.shape, overwrite_x=True) ** 2
    return np.sqrt(squares)


def _frequencies(I: Array) -> list[Array]:
    """Of a real transform, in waves per sample, along each axis."""
    along = [*map(fft.fftfreq, I.shape[:-1]), fft.rfftfreq(I.shape[-1])]
    return [f.astype(I.dtype) for f in np.ix_(*along)]


def _length(k: list[Array]) -> Array:
    return np.sqrt(reduce(np.add, [f**2 for f in k]))
