"""Lines of detectors: what is added to whole rows or columns of both images, and stays there."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from eofm.grid import Array, Mask, precision

# Parts into which lines are cut to see whether they are alike all along; and neighbouring
# frequencies whose spectra are averaged.
PARTS, NEAR = 8, 5
# Power that the parts of both images share, as a part of what chance leaves in it, where there are
# lines: speckle has 0.3 at most, structures of photographs 6.
CLEAR = 8.0
# A line differs from what is beside it, of so many places, by so many standard errors of that; and
# there are few of them: a part of all places.
BESIDE, CERTAIN, FEW = 15, 8.0, 0.1
# Standard errors by which a gain is off 1, if there is one.
SURE = 3.0
TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines along one axis, to be taken off.

    Attributes
    ----------
    axis : int
        Along which they change: 0 for rows of an image, 1 for columns.
    before, after : ndarray
        What was added to the images before and after compression, of a shape that goes with theirs.
    """

    axis: int
    before: Array
    after: Array


def without(lines: Iterable[Lines], I1: Array, I2: Array) -> tuple[Array, Array]:
    """Two images without some lines."""
    for line in lines:
        I1, I2 = I1 - line.before, I2 - line.after
    return I1, I2


def means_along(I1: Array, I2: Array, dead: Mask) -> list[tuple[Array, Array]]:
    """Means of parts of two images across each axis, in which lines are looked for.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width) or (depth, height, width)
    dead : ndarray of bool
        Pixels that do not count.
    """
    return [(_means(I1, dead, axis), _means(I2, dead, axis)) for axis in range(I1.ndim)]


def lines(means: Sequence[tuple[Array, Array]], single: bool) -> tuple[Lines, ...]:
    """Lines that both images show at the same places, all along.

    They may be of the sample: layers that hardly move look like that.

    Parameters
    ----------
    means : sequence of pairs of ndarray
        Of :func:`means_along`.
    single : bool
        Whether they are a few that differ from all beside them, or everywhere.
    """
    found, ndim = [], len(means)
    for axis, pair in enumerate(means):
        profiles = _single(*pair) if single else _all(*pair)
        if profiles is not None:
            shape = [-1 if k == axis else 1 for k in range(ndim)]
            before, after = (p.reshape(shape).astype(precision(ndim)) for p in profiles)
            found.append(Lines(axis, before, after))
    return tuple(found)


def _means(I: Array, dead: Mask, axis: int) -> Array:
    """Means across each of some parts of the image, at each place along an axis."""
    along = within(I.shape, axis)
    used = None if not dead.any() else ~dead
    middle = I.mean(where=True if used is None else used)
    means, counts = [], []
    for part in np.array_split(np.arange(I.shape[along[0]]), PARTS):
        at = (*[slice(None)] * along[0], slice(part[0], part[-1] + 1) if part.size else slice(0))
        where = True if used is None else used[at]
        counts.append(np.broadcast_to(where, I[at].shape).sum(along))
        total = I[at].sum(along, dtype=np.float64, where=where) - counts[-1] * middle
        means.append(total / np.maximum(counts[-1], 1))
    # Saturated lines are of one value: nothing shows below.
    told = (np.sum(counts, axis=0) > 0) & (I.min(along) < I.max(along))
    if not told.any():
        return np.zeros((PARTS, told.size))
    places = np.arange(told.size)
    return np.stack([np.interp(places, places[told], mean[told]) for mean in means])


def _single(means1: Array, means2: Array) -> tuple[Array, Array] | None:
    """A few lines that differ from what is beside them, and do so in all parts."""
    from scipy.ndimage import median_filter

    off = []
    for means in (means1, means2):
        # Brightness goes on beyond the ends.
        n = min(BESIDE // 2, means.shape[1] - 1)
        wider = np.pad(means, ((0, 0), (n, n)), "reflect", reflect_type="odd")
        off.append(means - median_filter(wider, (1, BESIDE))[:, n:-n])
    # Both images may show the same.
    both = (off[0] + off[1]) / 2
    error = both.std(0, ddof=1) / np.sqrt(len(both))
    told = np.abs(both.mean(0)) > CERTAIN * np.maximum(error, TINY)
    if not 0 < np.count_nonzero(told) <= FEW * told.size:
        return None
    return _alike(*(np.where(told, means.mean(0), 0.0) for means in off))


def _all(means1: Array, means2: Array) -> tuple[Array, Array] | None:
    """Lines everywhere: of each frequency as much as is not by chance (Wiener's filter)."""
    from scipy.fft import dct, idct
    from scipy.ndimage import uniform_filter1d

    P1, P2 = (dct(means, norm="ortho")[:, 1:] for means in (means1, means2))
    shared = in_common(P1, P2)
    own = ((P1**2).mean(0) + (P2**2).mean(0)) / 2 - shared
    shared, chance = (uniform_filter1d(f, NEAR) for f in (shared, own / PARTS))
    chance = np.maximum(chance, TINY)
    if not (shared / chance).mean() > CLEAR:
        return None
    share = np.maximum(shared, 0)
    share /= share + chance
    spectra = (np.concatenate([[0.0], share * P.mean(0)]) for P in (P1, P2))
    return _alike(*(idct(spectrum, norm="ortho") for spectrum in spectra))


def within(shape: tuple[int, ...], axis: int) -> tuple[int, ...]:
    """Axes of an image in which its lines lie that follow each other along one; longest first."""
    return tuple(sorted(set(range(len(shape))) - {axis}, key=lambda k: -shape[k]))


def in_common(P1: Array, P2: Array) -> Array:
    """Mean product of two different parts: what chance puts in each of them averages out."""
    return (P1.sum(0) * P2.sum(0) - (P1 * P2).sum(0)) / (PARTS * (PARTS - 1))


def _alike(p1: Array, p2: Array) -> tuple[Array, Array]:
    """The same profile in both images, but for a gain, if there clearly is one."""
    gain = float(np.sqrt((p2 @ p2) / (p1 @ p1)))
    rest = p2 - gain * p1
    if abs(gain - 1) < SURE * np.sqrt((rest @ rest) / (p1 @ p1) / np.count_nonzero(p1)):
        gain = 1.0
    p = (p1 + p2 / gain) / 2
    return p, gain * p
