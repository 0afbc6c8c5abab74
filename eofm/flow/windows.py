"""Correlations of small windows of two images that should match where they are.

Each window is correlated with the other image's at all offsets up to a quarter of its side, as in
particle image velocimetry (Keane and Adrian, Appl. Sci. Res. 49, 1992): where the highest peak
stands at no offset, the images agree; where a clear peak stands elsewhere, they contradict each
other. By chance few windows agree, so no level of noise has to be known. Windows are normalised
one by one: brightness and contrast may change from place to place.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from eofm.grid import Array, Mask, precision

# Sides of the windows, px, of images and of volumes, how many of them one should hold across, and
# the part of a side by which they overlap.
SIDES, ACROSS, OVERLAP = {2: (24, 64), 3: (16, 32)}, 6, {2: 2, 3: 1}
# Part of a window that has to carry data, and contrast of one that shows something, relative to
# the image's.
SEEN, CONTRAST = 0.5, 0.01
# Contrast, as a part of nearly the largest of a window, and correlation of neighbours in the first
# image (the second is interpolated), below which both show white noise alone there.
DIM, MOST, WHITE = 0.3, 0.95, 0.25
# Height of a clear peak, in robust standard deviations of the correlation around it.
CLEAR = 5.0
# Distance of a peak from no offset that is none, px, and how much higher one elsewhere stands.
NEAR, HIGHER = 1.5, 0.05
# Parts of the image across which a drift counts, and windows that tell it.
PARTS, FEW = 3, 3
TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class Windows:
    """Correlations of windows on a grid of them.

    Attributes
    ----------
    centres : tuple of ndarray
        Of the windows along each axis, px.
    here : ndarray, shape (rows, columns) or (slices, rows, columns)
        Correlation at offsets of up to ``NEAR`` px; NaN where there is no data.
    offset : ndarray, shape (ndim, ...)
        Of the peak there, px.
    agrees, contradicts : ndarray of bool
    empty : ndarray of bool
        Where both images show white noise alone; nothing else is said there.
    """

    centres: tuple[Array, ...]
    here: Array
    offset: Array
    agrees: Mask
    contradicts: Mask
    empty: Mask

    def parts(self) -> Iterator[tuple[NDArray[np.intp], ...]]:
        """Yield the index of the windows with data in each part of the image."""
        known = np.isfinite(self.here)
        for part in product(*(np.array_split(np.arange(n), PARTS) for n in known.shape)):
            index = np.nonzero(known[np.ix_(*part)])
            if len(index[0]) >= FEW:
                yield tuple(k[i] for k, i in zip(part, index, strict=True))

    def least(self) -> float:
        """Least share of agreeing windows in a part of the image."""
        return min((float(self.agrees[part].mean()) for part in self.parts()), default=1.0)

    def drift(self) -> float:
        """Largest median offset of the agreeing windows in a part of the image, px."""
        largest = 0.0
        for part in self.parts():
            agrees = self.agrees[part]
            if agrees.sum() >= FEW:
                offset = np.median([c[part][agrees] for c in self.offset], axis=1)
                largest = max(largest, float(length(offset)))
        return largest

    def on_pixels(self, shape: tuple[int, ...]) -> Array:
        """Return the correlation at each pixel, zero where windows do not agree."""
        values = np.where(self.agrees, np.clip(self.here, 0, 1), 0.0)
        values = values.astype(precision(len(shape)), copy=False)
        for axis, (n, centres) in enumerate(zip(shape, self.centres, strict=True)):
            at = np.clip(np.arange(n), centres[0], centres[-1])
            k = np.clip(np.searchsorted(centres, at, "right") - 1, 0, max(len(centres) - 2, 0))
            after = np.minimum(k + 1, len(centres) - 1)
            gaps = np.maximum(centres[after] - centres[k], TINY)
            along = [-1 if c == axis else 1 for c in range(len(shape))]
            first = values.take(k, axis)
            slope = (values.take(after, axis) - first) / gaps.reshape(along).astype(values.dtype)
            values = slope * (at - centres[k]).reshape(along).astype(values.dtype) + first
        return values


def correlate(I1: Array, I2: Array, used: Mask, side: int | None = None) -> Windows:
    """Correlate windows of two images that should match where they are.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width) or (depth, height, width)
    used : ndarray of bool, of that shape
        Pixels that carry data in both.
    side : int, optional
        Of the windows, px; by default what leaves some across the image.
    """
    ndim = I1.ndim
    if side is None:
        side = int(np.clip(min(I1.shape) // ACROSS, *SIDES[ndim])) // 4 * 4
    side = min(side, *I1.shape)
    *others, columns = starts = [_starts(n, side, OVERLAP[ndim]) for n in I1.shape]
    sides, axes = (side,) * ndim, tuple(range(1, ndim + 1))
    hann = np.hanning(side + 2)[1:-1]
    window: Array = reduce(np.multiply.outer, [hann] * ndim)
    spreads = [float(np.std(I[used])) + TINY if used.any() else TINY for I in (I1, I2)]
    reach = max(side // 4, 2)  # a peak has neighbours on both sides
    offsets = np.arange(-reach, reach + 1)
    # Windows that are shifted overlap less, which would lower peaks that stand off the middle.
    overlap = np.correlate(hann, hann, "full")[side - 1 + offsets] / (hann @ hann)
    overlaps = reduce(np.multiply.outer, [overlap] * ndim)
    near = length(np.meshgrid(*[offsets] * ndim)) <= NEAR
    shape = tuple(map(len, starts))
    here, elsewhere, spread, contrast, alike = (np.full(shape, np.nan) for _ in range(5))
    offset = np.full((ndim, *shape), np.nan)
    for k in np.ndindex(shape[:-1]):
        band = tuple(slice(s[i], s[i] + side) for s, i in zip(others, k, strict=True))
        bands = [
            np.stack([f[*band, c : c + side] for c in columns]).astype(np.float64)
            for f in (I1, I2, used)
        ]
        weight = window * bands[2]
        seen = weight.sum(axis=axes) >= SEEN * window.sum()
        a, size1 = _standardised(bands[0], weight)
        b, size2 = _standardised(bands[1], weight)
        seen &= (size1 > CONTRAST * spreads[0]) | (size2 > CONTRAST * spreads[1])
        if not seen.any():
            continue
        both = np.conj(fft.rfftn(a[seen], sides, axes)) * fft.rfftn(b[seen], sides, axes)
        plane = fft.irfftn(both, sides, axes)[:, *np.ix_(*[offsets] * ndim)] / overlaps
        here[*k, seen] = plane[:, near].max(axis=1)
        elsewhere[*k, seen] = plane[:, ~near].max(axis=1)
        offset[:, *k, seen] = _peaks(plane)
        spread[*k, seen] = np.median(np.abs(plane[:, ~near]), axis=1) / 0.6745
        contrast[*k, seen] = np.maximum(size1 / spreads[0], size2 / spreads[1])[seen]
        alike[*k, seen] = _neighbours(a[seen])
    clear = CLEAR * np.maximum(spread, TINY)
    known = np.isfinite(contrast)
    most = float(np.quantile(contrast[known], MOST)) if known.any() else 0.0
    with np.errstate(invalid="ignore"):
        empty = (contrast < DIM * most) & (alike < WHITE)
        here[empty] = np.nan
        agrees = here > elsewhere
        contradicts = (elsewhere > here + HIGHER) & (elsewhere > clear)
    middle = (side - 1) / 2
    centres = tuple(s + middle for s in starts)
    return Windows(centres, here, offset, agrees, contradicts, empty)


def length(v: Sequence[Array] | Array) -> Array:
    """Length of the vectors of a field."""
    return reduce(np.hypot, v)


def _peaks(plane: Array) -> Array:
    """Offsets of the highest peaks near the middle of planes, shape (ndim, n), px.

    A parabola through the logarithm of a Gaussian peak finds its top; here the peak is that of a
    correlation, and one through its values does.
    """
    m, ndim, n = plane.shape[1] // 2, plane.ndim - 1, np.arange(len(plane))
    part = plane[:, *[slice(m - 1, m + 2)] * ndim]
    k = part.reshape(len(part), -1).argmax(axis=1)
    top = [m - 1 + i for i in np.unravel_index(k, part.shape[1:])]
    tops = []
    for axis in reversed(range(ndim)):
        steps = ([i + s * (a == axis) for a, i in enumerate(top)] for s in (-1, 0, 1))
        low, middle, high = (plane[n, *at] for at in steps)
        curvature = np.minimum(low - 2 * middle + high, -TINY)
        tops.append(top[axis] - m + np.clip(0.5 * (low - high) / curvature, -0.5, 0.5))
    return np.stack(tops)


def _starts(n: int, side: int, overlap: int) -> NDArray[np.intp]:
    """First pixels of windows from end to end, ``overlap`` of them or more on each pixel."""
    count = max(1, -(-overlap * (n - side) // side) + 1)
    return np.linspace(0, n - side, count).round().astype(np.intp)


def _neighbours(f: Array) -> Array:
    """Largest correlation of neighbours in standardised windows, along any axis."""
    axes = tuple(range(1, f.ndim))
    shifted = ((np.delete(f, 0, k), np.delete(f, -1, k)) for k in axes)
    return np.max([(f1 * f0).sum(axis=axes) for f1, f0 in shifted], axis=0)


def _standardised(f: Array, weight: Array) -> tuple[Array, Array]:
    """Windows less their weighted means, times the weights, of norm 1; and their contrasts."""
    axes = tuple(range(1, f.ndim))
    total = np.maximum(weight.sum(axis=axes, keepdims=True), TINY)
    f = weight * (f - (weight * f).sum(axis=axes, keepdims=True) / total)
    size = np.sqrt((f * f).sum(axis=axes, keepdims=True))
    contrast = size / np.sqrt(np.maximum((weight**2).sum(axis=axes, keepdims=True), TINY))
    return f / np.maximum(size, TINY), contrast.ravel()
