"""Lines that flicker: rows or columns whose brightness or contrast is another one in each image.

A-lines of a source whose power varies, rows of a camera whose gain does, slices of a volume that
are scanned one after the other: what a line adds, or is multiplied by, is not that of the line
beside it, and changes from image to image. A displacement that follows it is wrong all along the
line. Lines of a volume are its slices across an axis.
"""

from typing import TYPE_CHECKING

import numpy as np

from eofm.grid import Array, Mask
from eofm.imaging.lines import PARTS, in_common, within

if TYPE_CHECKING:
    from scipy import sparse

# Power that parts of lines share where there are such lines: as a part of what chance leaves in it,
# and of that of the image. Without them the first is 0.2 at most, but where images match so well
# that errors of interpolation are all that is left; lines of 3 percent of an image's contrast have
# 1 to 20.
CLEAR, SEEN = 2.0, 0.01**2
# Lines, of which the mean is taken off to see what differs from those beside, or half of all of
# them: what changes smoothly from line to line is shading.
BESIDE = 15
# Part of the lines that do not count, those with most in common: along a crack, a few have that.
FEW = 0.1
# Least power, as a part of what chance leaves, that lines are given.
FAINT = 1e-3
# Standard deviations beyond which a difference of the images says no more.
FAR = 4.0
# Least contrast of a line, as a part of the image's, when all are given the same.
LEAST = 0.05
# Pixels of which equations are summed up at once.
CHUNK = 2**18
TINY = float(np.finfo(np.float32).tiny)


def in_both(before: Array, rest: Array) -> Array:
    """What two images show alike, but for its mean: the first one, and what is left of it."""
    return before - before.sum() / max(1, before.size) - rest / 2


def flickers(seen: Array, rest: Array, used: Mask) -> tuple[int, ...]:
    """Axes of two images along which lines flicker.

    Parameters
    ----------
    seen, rest : ndarray, shape (N,)
        What both images show after a displacement, see :func:`in_both`, and what it leaves of
        their difference, at the N pixels that are ``used``.
    used : ndarray of bool, shape (height, width) or (depth, height, width)
    """
    rest, axes = _near(rest), []
    for axis in range(used.ndim):
        for f in _functions(seen):
            shared, chance = _power(rest, f, used, axis, smooth=False)
            if shared > max(CLEAR * chance, SEEN * seen.var()):
                axes.append(axis)
                break
    return tuple(axes)


def level(I: Array, axis: int, dead: Mask) -> Array:
    """The image with one brightness and one contrast of all its lines.

    Parameters
    ----------
    axis : int
        Along which lines follow each other: 0 for rows of an image, 1 for columns.
    """
    live, along = ~dead, within(I.shape, axis)
    counts = np.maximum(live.sum(along, keepdims=True), 1)
    off = I - (I * live).sum(along, keepdims=True) / counts
    contrast = np.sqrt((off**2 * live).sum(along, keepdims=True) / counts)
    usual = float(np.median(contrast))
    off *= usual / np.maximum(contrast, LEAST * usual + TINY)
    return off + I.mean(where=live)


def without_changes(
    images: tuple[Array, Array], seen: Array, rest: Array, used: Mask, u: Array, axis: int
) -> tuple[Array, Array]:
    """Two images without what their lines add, and with one contrast of all lines, to first order.

    Least squares of all profiles together, as a displacement that varies along a line tells those
    of both images apart. Each is shrunk as far as chance makes it (Wiener's filter): where lines
    do not flicker, nothing is taken off.

    Parameters
    ----------
    images : pair of ndarray, shape (height, width) or (depth, height, width)
    seen, rest, used
        See :func:`flickers`.
    u : ndarray, shape (2, height, width) or (3, depth, height, width)
        The displacement, px.
    axis : int
    """
    from scipy import sparse
    from scipy.sparse.linalg import cg

    n, rest = used.shape[axis], _near(rest)
    functions, ridge = _functions(seen), []
    for f in functions:
        shared, chance = _power(rest, f, used, axis)
        # Half of what changes is of each image.
        own = chance * float(f @ f) / n
        ridge += 2 * [own / max(shared / 2, FAINT * chance, TINY)]
    at: Array = np.indices(used.shape, sparse=True)[axis]
    here = np.broadcast_to(at, used.shape)[used].astype(float)
    there = (at + u[used.ndim - 1 - axis])[used].clip(0, n - 1)
    K, b = sparse.diags_array(np.repeat(ridge, n)).tocsr(), np.zeros(4 * n)
    for first in range(0, rest.size, CHUNK):
        some = slice(first, first + CHUNK)
        lines = [_between(here[some], n), -_between(there[some], n)]
        B = sparse.hstack([sparse.diags_array(f[some]) @ line for f in functions for line in lines])
        B = B.tocsr()
        K, b = K + B.T @ B, b + B.T @ rest[some]
    profiles, _ = cg(K, b, rtol=1e-6, maxiter=500)
    profiles = np.expand_dims(profiles.reshape(2, 2, n), [2 + k for k in within(used.shape, axis)])
    steady = []
    for I, added, changed in zip(images, *profiles, strict=True):
        middle = I.mean(where=used)
        added, changed = added * (I.std() / images[0].std()), changed / seen.std()
        steady.append(middle + (I - middle - added) / (1 + changed))
    return steady[0], steady[1]


def _between(places: Array, n: int) -> "sparse.csr_array":
    """Values at places along an axis, between those of n lines, as a matrix."""
    from scipy import sparse

    line = places.astype(np.intp).clip(0, n - 2)
    t, row = places - line, np.arange(places.size)
    entries = np.concatenate([1 - t, t]), (np.tile(row, 2), np.concatenate([line, line + 1]))
    return sparse.csr_array(entries, (places.size, n))


def _functions(seen: Array) -> tuple[Array, Array]:
    """What lines add, and what they change the contrast of, alike in size."""
    return np.ones_like(seen), seen / (seen.std() + TINY)


def _near(rest: Array) -> Array:
    """Differences without what is far from all others: something else than lines."""
    usual = float(np.median(np.abs(rest))) / 0.6745
    return rest.clip(-FAR * usual, FAR * usual)


def _power(
    rest: Array, f: Array, used: Mask, axis: int, smooth: bool = True
) -> tuple[float, float]:
    """Power of the factors of f in each line that its parts share, and what chance leaves in it.

    Either of all of them, or only of what differs from the lines beside, but for a few lines.
    """
    from scipy.ndimage import uniform_filter1d

    sums, along = [], within(used.shape, axis)
    for values in (rest * f, f * f):
        whole = np.zeros(used.shape)
        whole[used] = values
        sums.append(np.stack([part.sum(along) for part in np.array_split(whole, PARTS, along[0])]))
    product, square = sums
    enough = square > 0.1 * square.mean()
    factors = np.divide(product, square, where=enough, out=np.zeros(square.shape))
    if smooth:
        factors -= np.median(factors)
    else:
        # Those at the ends have none beside them on one side.
        beside = min(BESIDE, factors.shape[1] // 2 | 1)
        off = factors - uniform_filter1d(factors, beside)
        factors = off[:, beside // 2 : off.shape[1] - beside // 2]
    lines = in_common(factors, factors)
    if not smooth:
        lines = np.sort(lines)[: lines.size - int(FEW * lines.size)]
    shared = float(lines.mean())
    return shared, max((float((factors**2).mean()) - shared) / PARTS, TINY)
