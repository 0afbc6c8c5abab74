"""What is printed on both images and stays: frames, sectors of scanners, text, scale bars."""

import numpy as np

from eofm.grid import Array, Mask
from eofm.imaging.defects import MARGIN, parts, with_margin

# Where a frame ends, the sample begins at once: what is beside it differs from its value by so much
# of what all others do. A sample that is black itself, or clipped, goes over to that smoothly.
ABRUPT = 0.5
# Part of the spread of other rows that a row of a frame has at most; rows next to it, and the part
# of what these are off at most that the first of them is at least.
FLAT, NEXT, BESIDE = 0.35, 4, 0.7
# Part of the pixels beside a sector that may have its value in one image only; and values at the
# edges that are looked at.
CHANGED, VALUES = 0.25, 4
# So many pixels are beside a sector, for each that it has at the edges, at most: a sample of one
# piece is within it. What is between dots of a sample, which may hardly move, has many more.
LONG = 3.0
# Labels are nearly as bright or as dark as anything, in so many pixels. The images differ there,
# for their gradients, by so much of what they do elsewhere; gradients of both are nearly as large,
# and steeper than elsewhere; and they cover so much at most.
EXTREME, LEAST, STILL, ALIKE, SHARP, RARE = (1 / 16, 1 / 4), 8, 0.2, 0.15, 1.5, 0.1
# First and last of an axis, and which way it goes on from there.
ENDS = (0, 1), (-1, -1)
TINY = float(np.finfo(np.float32).tiny)


def frames(I1: Array, I2: Array, dead: Mask | None = None) -> Mask:
    """Pixels of frames and of sectors, with what is next to them, but what is dead already.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width) or (depth, height, width)
        Of one grey scale.
    dead : ndarray of bool, of their shape, optional
        Pixels that are left out anyway. Where a frame ends with them, what is next to it is the
        sample.
    """
    found = np.zeros(I1.shape, dtype=bool)
    if np.array_equal(I1, I2):
        return found
    inner = _box(I1, I2)
    J1, J2 = I1[inner], I2[inner]
    found[...] = True
    found[inner] = _sectors(J1, J2)
    if dead is None:
        return with_margin(found)
    # A few pixels that have by chance the value with which dead ones were filled are no frame.
    label, _, count = parts(found & ~dead)
    sizes = np.bincount(label.ravel(), minlength=count + 1)
    return with_margin(found & ~dead & (sizes >= LEAST)[label]) & ~dead


def _box(I1: Array, I2: Array) -> tuple[slice, ...]:
    """What is inside of a frame of whole rows and columns; each edge may have another value."""
    inner = whole = tuple(slice(0, n) for n in I1.shape)
    # Rows end in the columns of a frame, which may have another value.
    for _ in range(2):
        for axis in range(I1.ndim):
            start, stop = inner[axis].start, inner[axis].stop
            before, after = _widths(I1[inner], I2[inner], axis)
            if before + after < stop - start:
                inner = *inner[:axis], slice(start + before, stop - after), *inner[axis + 1 :]
        if inner == whole:
            break
    return inner


def _widths(I1: Array, I2: Array, axis: int) -> list[int]:
    """How many rows from either end on are a frame: one value, but for noise, in both images."""
    across = tuple(k for k in range(I1.ndim) if k != axis)
    lines = [(I.mean(across), I.std(across)) for I in (I1, I2)]
    widths = []
    for end, step in ENDS:
        counts = set[int]()
        for means, spreads in lines:
            least = FLAT * float(np.median(spreads))
            flat = (spreads <= least) & (np.abs(means - means[end]) <= least)
            counts.add(int(np.argmin([*flat[::step], False])))
        count = counts.pop()
        if counts or not 0 < count < I1.shape[axis]:
            widths.append(0)
            continue
        off = _off(I1, I2, float(np.take(I1, end, axis).mean())).mean(across)[::step][count:]
        abrupt = off[0] > max(ABRUPT * off.mean(), BESIDE * off[:NEXT].max())
        widths.append(count if abrupt else 0)
    return widths


def _off(I1: Array, I2: Array, value: float) -> Array:
    """How far off a value the pixels are, in the image where they are less so."""
    return np.minimum(np.abs(I1 - value), np.abs(I2 - value))


def _sectors(I1: Array, I2: Array) -> Mask:
    """Connected pixels of one value in both images, from the edges to where the sample begins."""
    found, rim = np.zeros(I1.shape, dtype=bool), np.ones(I1.shape, dtype=bool)
    rim[(slice(1, -1),) * I1.ndim] = False
    # What is clipped where it is bright ends at once as well.
    values, counts = np.unique(I1[rim & (I1 == I2) & (I1.max() > I1)], return_counts=True)
    for value in values[np.argsort(-counts, kind="stable")][:VALUES]:
        alike = (value == I1) & (value == I2)
        if alike.all():
            continue
        label, beside, count = parts(alike)
        off, changed = _off(I1, I2, value), (value == I1) != (value == I2)
        touching = np.maximum(np.bincount(beside.ravel(), minlength=count + 1), 1)
        jump = np.bincount(beside.ravel(), off.ravel(), count + 1) / touching
        changes = np.bincount(beside[changed], minlength=count + 1) / touching
        edge = np.bincount(label[rim], minlength=count + 1)
        kept = (edge >= LEAST) & (touching <= LONG * edge)
        kept &= (jump > ABRUPT * off[~alike].mean()) & (changes <= CHANGED)
        kept[0] = False
        found |= kept[label]
    return found


def suspects(I1: Array, I2: Array) -> Mask:
    """Very bright or dark parts that seem to stay while others move, with what is next to them.

    Labels, but also structures that are clipped where the sample hardly moves.
    """
    slopes = [
        np.sqrt(sum(np.square(np.gradient(I, axis=k)) for k in range(I.ndim))) for I in (I1, I2)
    ]
    seen = np.abs(I1 - I2), *slopes, slopes[0] ** 2 + slopes[1] ** 2
    changes = np.full(I1.shape, np.inf)
    for value in (min(I1.min(), I2.min()), max(I1.max(), I2.max())):
        off = np.maximum(np.abs(I1 - value), np.abs(I2 - value))
        for near in (off <= apart for apart in EXTREME):
            if np.count_nonzero(near) >= LEAST:
                changes = np.minimum(changes, _changes(near, *seen))
    found: Mask = changes < min(STILL, np.quantile(changes, RARE, method="lower"))
    return with_margin(found)


def _changes(near: Mask, differs: Array, slope1: Array, slope2: Array, squares: Array) -> Array:
    """How much images change in parts that may be labels, as a part of what they do elsewhere.

    For their gradients, as what moves by less changes less; infinite elsewhere.
    """
    from scipy import ndimage

    whole = ndimage.generate_binary_structure(near.ndim, near.ndim)
    # Letters belong together, and what is beside them to them.
    label, count = ndimage.label(ndimage.binary_dilation(near, whole, MARGIN), whole)
    at = np.nonzero(label)
    number = label[at]
    change, first, second, square = (
        np.bincount(number, f[at], count + 1) for f in (differs, slope1, slope2, squares)
    )
    slope = first + second + TINY
    rest = float(slope1.sum() + slope2.sum() - slope.sum()) + TINY
    usual = float(differs.sum() - change.sum()) / rest, float(squares.sum() - square.sum()) / rest
    told = (np.abs(first - second) <= ALIKE * slope) & (square / slope >= SHARP * usual[1])
    told &= np.bincount(label[near], minlength=count + 1) >= LEAST
    told[0] = False
    changes: Array = np.where(told, change / slope / (usual[0] + TINY), np.inf)[label]
    return changes
