"""Pixels that show the detector instead of the sample: highlights, saturated lines, impulses."""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eofm.grid import Array, Mask
from eofm.imaging.intensity import CHUNK, Window

# A highlight is so many times as high above the median as three in four local maxima are, which
# are the brightest of squares of PEAK px; and its surroundings, px, are none the better.
HIGHLIGHT, PEAK, MARGIN = 4.0, 5, 2
# An image, or a volume, of large structures has less than one maximum in so many of these squares,
# or cubes; of so few, highlights may be a quarter.
SPACIOUS = {2: 8, 3: 2}
# They may even be most of them. Then a highlight is so many times as high as all pixels but BRIGHT
# are, if these are no few bright ones on black: not much higher than all but LIGHT.
BRIGHT, LIGHT, SPREAD = 0.98, 0.84, 2.5
# Where there are more of them, that is what the sample looks like: of the whole, and of a Gaussian
# window of a width, px. The skin is as bright, in a scan that shows air above it.
RARE = 0.05
ISOLATED, NEIGHBOURHOOD = 0.02, 16.0
# Length of a bright line of one value that no structure makes, px, if not more than a part of the
# pixels that touch it has that value: structures that are clipped are ragged.
LINE, RAGGED = 32, 0.25
# Side of a square, or a cube, of one value, that is too thick for a line, px.
THICK = 7
# An impulse differs so many times as far from its neighbours' mean as three in four pixels do, and
# so much of what it differs by from its surroundings from all neighbours but one: the light of
# no lens does, whose points are wider than a pixel.
IMPULSE, ALONE = 4.0, 0.7
# Least part of what surroundings vary by, but for two pixels at either end.
CLEAR = 0.35


class Heights(NamedTuple):
    """How high above the median an image, or a volume, is.

    Attributes
    ----------
    usual, middle : float
        What three in four pixels of local maxima have at most, and the middle one of the maxima.
    bright, light : float
        What all pixels but BRIGHT and LIGHT have at most.
    largest : float
        The brightest pixel.
    """

    usual: float
    middle: float
    bright: float
    light: float
    largest: float

    def of_highlights(self, count: int, shape: tuple[int, ...]) -> float:
        """Height from which a pixel is a highlight, of an image with so many maxima."""
        ndim, height = len(shape), HIGHLIGHT * self.usual
        if height > self.largest and count * SPACIOUS[ndim] * PEAK**ndim < np.prod(shape):
            height = HIGHLIGHT * self.middle
        if height > self.largest and self.bright < SPREAD * self.light:
            height = HIGHLIGHT * self.bright
        return height


class Levels(NamedTuple):
    """Intensities that tell pixels of the detector from those of the sample.

    Attributes
    ----------
    median : float
    highlight : float
        Height of highlights above the median; infinite for none.
    lines : bool
        Whether there may be saturated lines.
    bump : float
        Sum of second differences of an impulse; infinite for none.
    """

    median: float
    highlight: float
    lines: bool
    bump: float

    @classmethod
    def of(cls, I: Array) -> "Levels | None":
        """Return those of an image or a volume; None if it has no peaks."""
        median = np.median(I)
        every, single = (above[above > 0] for above in (I[found] - median for found in peaks(I)))
        if not every.size:
            return None
        some = I.ravel()[:: max(1, I.size // CHUNK)]
        bright, light = np.quantile(some, [BRIGHT, LIGHT]) - median
        usual, middle = np.quantile(every, 0.75), np.median(single)
        heights = Heights(usual, middle, bright, light, every.max())
        highlight = heights.of_highlights(single.size, I.shape)
        steep = bumps(I)
        bump = IMPULSE * np.quantile(steep.ravel()[:: max(1, steep.size // CHUNK)], 0.75)
        return cls(median, highlight, True, bump if rare(steep > bump, 2 * RARE) else np.inf)

    @property
    def any(self) -> bool:
        """Whether there may be defects."""
        return self.lines or bool(np.isfinite([self.highlight, self.bump]).any())

    def marked(self, I: Array) -> Mask:
        """Pixels of highlights and saturated lines."""
        return self.lit(I) | self.lined(I)

    def lit(self, I: Array) -> Mask:
        """Pixels of highlights."""
        return highlights(I - self.median, self.highlight)

    def lined(self, I: Array) -> Mask:
        """Pixels of saturated lines."""
        return _lines(I, self.median < I) if self.lines else np.zeros(I.shape, dtype=bool)

    def single(self, I: Array) -> Mask:
        """Impulses: pixels that are bright or dark alone, as hot and dead ones are."""
        found: Mask = np.zeros(I.shape, dtype=bool)
        at = np.nonzero(bumps(I) > self.bump)
        offsets = np.array(list(product(range(-2, 3), repeat=I.ndim))).T
        padded = np.pad(I, 2, mode="edge")
        around = padded[tuple(k + o[:, None] + 2 for k, o in zip(at, offsets, strict=True))]
        middle = np.median(around, axis=0)
        sign = np.sign(I[at] - middle)
        near = np.abs(offsets).max(axis=0) == 1
        # Two impulses may be neighbours.
        second = np.sort(sign * around[near], axis=0)[-2]
        around.sort(axis=0)
        least = np.maximum(ALONE * sign * (I[at] - middle), CLEAR * (around[-3] - around[2]))
        found[at] = sign * I[at] - second > least
        return found


def peaks(I: Array) -> tuple[Mask, Mask]:
    """Local maxima, the brightest of squares of PEAK px: all their pixels, and one of a plateau.

    Of an image of large structures, which has few maxima, those of highlights may have the most
    pixels, for they are flat; then nothing is high enough for one.
    """
    # Its import takes a tenth of a short estimate.
    from scipy import ndimage

    reach = PEAK // 2
    found: Mask = ndimage.maximum_filter(I, PEAK) <= I
    at, before = np.nonzero(found), np.pad(found, reach)
    first = np.ones(len(at[0]), dtype=bool)
    for offsets in product(range(-reach, reach + 1), repeat=I.ndim):
        if offsets < (0,) * I.ndim:
            first &= ~before[tuple(k + o + reach for k, o in zip(at, offsets, strict=True))]
    single = np.zeros_like(found)
    single[at] = first
    return found, single


def bumps(I: Array) -> Array:
    """Sum of the second differences along all axes, without its sign; 0 of what an edge cuts."""
    total = np.zeros_like(I)
    for axis in range(I.ndim):
        inner = tuple(slice(1, -1) if k == axis else slice(None) for k in range(I.ndim))
        total[inner] += np.diff(I, 2, axis)
    return np.abs(total, out=total)


def rare(found: Mask, part: float = RARE) -> bool:
    """Whether there are some pixels, and few of them."""
    return bool(0 < np.count_nonzero(found) < part * found.size)


def highlights(above: Array, height: float) -> Mask:
    """Pixels that are so high above the median, and stand alone."""
    found = above > height
    if found.any():
        share = Window(np.ones_like(found), NEIGHBOURHOOD).mean(found.astype(above.dtype))
        found &= share < ISOLATED
    return found


def defects(I: Array, levels: Levels | None = None) -> Mask:
    """Pixels that show the detector instead of the sample, see `defects_by_kind`."""
    found = np.zeros(I.shape, dtype=bool)
    for kind in defects_by_kind(I, levels).values():
        found |= kind
    return found


def defects_by_kind(I: Array, levels: Levels | None = None) -> dict[str, Mask]:
    """Highlights and saturated lines, with what is next to them, and pixels that stand alone.

    Saturated pixels as such are none: what is clipped where it is bright moves with the
    sample. Highlights stand alone, and none is found where it would make up more than 5 % of the
    image or volume. Of a part of an image that has defects, the ``levels`` are those of the
    whole.
    """
    own = levels or Levels.of(I)
    if own is None:
        return {}
    marked, single = {"highlights": own.lit(I), "saturated lines": own.lined(I)}, own.single(I)
    if levels is None:
        single &= rare(single)
        if not rare(np.logical_or(*marked.values())):
            marked = {}
    marked = {kind: with_margin(found) for kind, found in marked.items()}
    return marked | {"single pixels": single}


def with_margin(found: Mask) -> Mask:
    """Some pixels with what is next to them."""
    if not found.any():
        return found
    from scipy import ndimage

    wider: Mask = ndimage.binary_dilation(found, iterations=MARGIN)
    return wider


def parts(found: Mask) -> tuple[NDArray[np.integer], NDArray[np.integer], int]:
    """Numbers, from 1, of the connected parts of a mask and of the part beside others; the count.

    Corners connect. Both are 0 elsewhere.
    """
    from scipy import ndimage

    label, count = ndimage.label(found, ndimage.generate_binary_structure(found.ndim, found.ndim))
    beside = ndimage.maximum_filter(label, 3)
    beside[found] = 0
    return label, beside, count


def _lines(I: Array, bright: Mask) -> Mask:
    """Bright lines of one value.

    A saturated one need not be the brightest: highlights may be brighter.
    """
    from scipy import ndimage

    lines = np.zeros(I.shape, dtype=bool)
    for axis in range(I.ndim):
        along, lit, found = (np.moveaxis(f, axis, 0) for f in (I, bright, lines))
        same = (np.diff(along, axis=0) == 0) & lit[:-1]
        if np.count_nonzero(same) >= LINE - 1:
            # What a segment of that length can cover: of an opening, both steps.
            starts = ndimage.minimum_filter1d(same.view(np.uint8), LINE - 1, 0, mode="constant")
            same = ndimage.maximum_filter1d(starts, LINE - 1, 0, mode="constant").view(bool)
            found[:-1] |= same
            found[1:] |= same
    return _straight(I, lines) if lines.any() else lines


def _straight(I: Array, lines: Mask) -> Mask:
    """Those of some lines that are thin, and that few pixels of their value touch."""
    from scipy import ndimage

    low, high = (
        f(I, THICK, mode="nearest") for f in (ndimage.minimum_filter, ndimage.maximum_filter)
    )
    lines = lines & ~ndimage.maximum_filter(low == high, THICK)
    label, wider, count = parts(lines)
    value = np.zeros(count + 1, I.dtype)
    value[label[lines]] = I[lines]
    touching = np.bincount(wider.ravel(), minlength=count + 1)
    alike = np.bincount(wider[value[wider] == I], minlength=count + 1)
    straight: Mask = alike <= RAGGED * touching
    straight[0] = False
    return straight[label]


def filled(I: Array, dead: Mask) -> Array:
    """The image or volume with each dead pixel as its nearest live one."""
    if not dead.any() or dead.all():
        return I
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(dead, return_distances=False, return_indices=True)
    J = I.copy()
    J[dead] = I[tuple(k[dead] for k in nearest)]
    return J
