"""Whether the images bear an estimate out: a verdict with its reasons.

After the second image has been carried back by an estimate, small windows of both images should
match where they are. Each window is correlated with the other image's at all offsets up to a
quarter of its side, as in particle image velocimetry (Keane and Adrian, Appl. Sci. Res. 49, 1992):
where the highest peak stands at no offset, the images agree with the estimate; where a clear peak
stands elsewhere, they contradict it. By chance few windows agree, so no level of noise has to be
known. Windows are normalised one by one: brightness and contrast may change from place to place.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from eofm.grid import FACES, Array, Edge, Mask, precision

Verdict = Literal["good", "doubtful", "failed"]

# Sides of the windows, px, of images and of volumes, how many of them one should hold across, and
# the part of a side by which they overlap.
SIDES, ACROSS, OVERLAP = {2: (24, 64), 3: (16, 32)}, 6, {2: 2, 3: 1}
# Part of a window that has to carry data, and contrast of one that shows something, relative to
# the image's.
SEEN, CONTRAST = 0.5, 0.01
# Height of a clear peak, in robust standard deviations of the correlation around it.
CLEAR = 5.0
# Distance of a peak from no offset that is none, px, and how much higher one elsewhere stands.
NEAR, HIGHER = 1.5, 0.05
# Share of agreeing windows below which an estimate is doubtful, and has failed. Of windows that
# have nothing in common three in a hundred agree by chance, and one in four after a flow has done
# its best to make them alike.
AGREED = 0.75, 0.35
# What else raises doubts: the share of windows that contradict, the share that agree in a part of
# the image, the median correlation, the drift of a part in px, the share of pixels that are folded
# over, and that carry data.
CONTRADICTED, PARTLY, CORRELATED, DRIFTED, FOLDED, USED = 0.05, 0.5, 0.7, 0.25, 0.005, 0.1
# Parts of the image across which a drift counts, and windows that tell it.
PARTS, FEW = 3, 3
# Rows from an edge whose line tells where the images would have it, and how far off it may be, px.
ROWS, JUMP = (8, 24), 0.5
# Slices, or rows, whose gradients are taken at once.
SLAB = 16
# Differences of images and displacements that are none.
SAME = 1e-6
STATED = "the images contradict the motion that was stated; check it"
SAME_IMAGES = "both images are the same; check that the right files were given"
TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class Trust:
    """What the images say of an estimate.

    Attributes
    ----------
    verdict : {"good", "doubtful", "failed"}
    reasons : tuple of str
        Why it is not good, and what to do, a line each.
    map : ndarray, shape (height, width) or (depth, height, width)
        Correlation of the images around each pixel, from 0 (or contradicted) to 1; NaN where
        there is no data.
    agreeing, contradicting : float
        Shares of the windows with data whose highest peak stands at no offset, and clearly
        elsewhere.
    part : float
        Least share of agreeing windows in a part of the image.
    correlation : float
        Median of the correlation at no offset.
    drift : float
        Largest offset of the peaks in a part of the image, median of its windows, px.
    folded, used : float
        Shares of the pixels where ``det(I + grad u) <= 0``, and that carry data.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    map: Array
    agreeing: float
    contradicting: float
    part: float
    correlation: float
    drift: float
    folded: float
    used: float

    def on(self, shape: tuple[int, ...]) -> "Trust":
        """Return the same with a map of another size, each pixel taking the nearest value."""
        if shape == self.map.shape:
            return self
        nearest = (
            np.linspace(0, old - 1, new).round().astype(np.intp)
            for old, new in zip(self.map.shape, shape, strict=True)
        )
        return replace(self, map=self.map[np.ix_(*nearest)])

    def summary(self) -> dict[str, float | str | list[str]]:
        """Return all but the map, for a file."""
        numbers = {f.name: getattr(self, f.name) for f in fields(self) if f.type is float}
        return {"verdict": self.verdict, "reasons": list(self.reasons), **numbers}


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
    """

    centres: tuple[Array, ...]
    here: Array
    offset: Array
    agrees: Mask
    contradicts: Mask

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
    least = [CONTRAST * np.std(I[used]) if used.any() else 0.0 for I in (I1, I2)]
    reach = max(side // 4, 2)  # a peak has neighbours on both sides
    offsets = np.arange(-reach, reach + 1)
    # Windows that are shifted overlap less, which would lower peaks that stand off the middle.
    overlap = np.correlate(hann, hann, "full")[side - 1 + offsets] / (hann @ hann)
    overlaps = reduce(np.multiply.outer, [overlap] * ndim)
    near = length(np.meshgrid(*[offsets] * ndim)) <= NEAR
    shape = tuple(map(len, starts))
    here, elsewhere, spread = (np.full(shape, np.nan) for _ in range(3))
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
        seen &= (size1 > least[0]) | (size2 > least[1])
        if not seen.any():
            continue
        both = np.conj(fft.rfftn(a[seen], sides, axes)) * fft.rfftn(b[seen], sides, axes)
        plane = fft.irfftn(both, sides, axes)[:, *np.ix_(*[offsets] * ndim)] / overlaps
        here[*k, seen] = plane[:, near].max(axis=1)
        elsewhere[*k, seen] = plane[:, ~near].max(axis=1)
        offset[:, *k, seen] = _peaks(plane)
        spread[*k, seen] = np.median(np.abs(plane[:, ~near]), axis=1) / 0.6745
    clear = CLEAR * np.maximum(spread, TINY)
    with np.errstate(invalid="ignore"):
        agrees = here > elsewhere
        contradicts = (elsewhere > here + HIGHER) & (elsewhere > clear)
    middle = (side - 1) / 2
    centres = tuple(s + middle for s in starts)
    return Windows(centres, here, offset, agrees, contradicts)


def length(v: Sequence[Array] | Array) -> Array:
    """Length of the vectors of a field."""
    return reduce(np.hypot, v)


def folds(u: Array) -> float:
    """Share of the pixels where ``det(I + grad u) <= 0``, for ``u`` in px."""
    count, n = 0, u.shape[1]
    for start in range(0, n, SLAB):
        first, last = max(start - 1, 0), min(start + SLAB + 1, n)
        gradient = [list(np.gradient(c[first:last])[::-1]) for c in u]
        for c, row in enumerate(gradient):
            row[c] += 1
        inner = slice(start - first, min(start + SLAB, n) - first)
        count += int(np.count_nonzero(_determinant(gradient)[inner] <= 0))
    return count / math.prod(u.shape[1:])


def _determinant(J: list[list[Array]]) -> Array:
    """Determinants of a matrix of arrays, along its first row."""
    if len(J) == 1:
        return J[0][0]
    minors = ([row[:j] + row[j + 1 :] for row in J[1:]] for j in range(len(J)))
    signs = (1 if j % 2 == 0 else -1 for j in range(len(J)))
    terms = [s * a * _determinant(m) for s, a, m in zip(signs, J[0], minors, strict=True)]
    return reduce(np.add, terms)


def judge(I1: Array, warped: Array, used: Mask, u: Array, edges: Collection[Edge] = ()) -> Trust:
    """Verdict on a displacement.

    Parameters
    ----------
    I1, warped : ndarray, shape (height, width) or (depth, height, width)
        The image before compression, and the one after it at ``x + u(x)``.
    used : ndarray of bool, of that shape
        Pixels that carry data: neither dead nor moved out of the image.
    u : ndarray, shape (2, ...) or (3, ...)
        In px.
    edges : collection of str
        Those whose motion was stated.
    """
    windows = correlate(I1, warped, used)
    known = np.isfinite(windows.here)
    count = max(int(known.sum()), 1)
    shares = {
        "agreeing": float(windows.agrees.sum() / count),
        "contradicting": float(windows.contradicts.sum() / count),
        "correlation": float(np.median(windows.here[known])) if known.any() else 0.0,
        "part": windows.least(),
        "drift": windows.drift(),
        "folded": folds(u),
        "used": float(used.mean()),
    }
    failed = _failures(**shares)
    doubts = [] if failed else _doubts(**shares)
    doubts += _contradicted(windows, u, edges)
    if np.allclose(I1, warped, atol=SAME) and np.allclose(u, 0, atol=SAME):
        doubts.append(SAME_IMAGES)
    verdict: Verdict = "failed" if failed else "doubtful" if doubts else "good"
    trust = np.where(used, windows.on_pixels(I1.shape), np.nan)
    return Trust(verdict, (*failed, *doubts), trust, **shares)


def pooled(parts: Sequence[Mapping[str, Any]], voxels: Sequence[int]) -> Trust:
    """Verdict on a field of whose parts each has a summary; its map is empty.

    The parts, of so many ``voxels``, take the place of the parts of an image.
    """
    data = [v * part["used"] for v, part in zip(voxels, parts, strict=True)]

    def mean(key: str, weights: Sequence[float]) -> float:
        total = sum(w * part[key] for w, part in zip(weights, parts, strict=True))
        return float(total / max(sum(weights), TINY))

    shares = {key: mean(key, data) for key in ("agreeing", "contradicting", "correlation")}
    shares |= {key: mean(key, voxels) for key in ("folded", "used")}
    shares["part"] = min((p["agreeing"] for p in parts if p["used"] > USED), default=1.0)
    shares["drift"] = max(part["drift"] for part in parts)
    failed = _failures(**shares)
    doubts = [] if failed else _doubts(**shares)
    # What is said of edges and of equal images is true of the whole where it is of a part.
    said = [reason for part in parts for reason in part["reasons"] if STATED in reason]
    if all(any(SAME_IMAGES in reason for reason in part["reasons"]) for part in parts):
        said.append(SAME_IMAGES)
    doubts += dict.fromkeys(said)
    verdict: Verdict = "failed" if failed else "doubtful" if doubts else "good"
    return Trust(verdict, (*failed, *doubts), np.empty(0), **shares)


def _failures(agreeing: float, contradicting: float, used: float, **_: float) -> list[str]:
    if used == 0:
        return ["no part of the image carries data; check the mask and the motion"]
    if agreeing < max(AGREED[1], contradicting):
        return [
            f"only {agreeing:.0%} of the image match the other one after the motion; check that"
            " both show the same sample, or state its edges or a background"
        ]
    return []


def _doubts(
    agreeing: float,
    contradicting: float,
    part: float,
    correlation: float,
    drift: float,
    folded: float,
    used: float,
) -> list[str]:
    doubts = []
    if used < USED:
        doubts.append(f"only {used:.0%} of the image carry data; make the mask smaller")
    if agreeing < AGREED[0]:
        doubts.append(
            f"only {agreeing:.0%} of the image match after the motion; see the map of trust"
        )
    elif part < PARTLY:
        doubts.append(
            f"in a part of the image only {part:.0%} match after the motion; see the map of trust"
        )
    if contradicting > CONTRADICTED:
        doubts.append(
            f"{contradicting:.0%} of the image match better elsewhere; the motion may be too large,"
            " or what was stated of it wrong"
        )
    if correlation < CORRELATED:
        doubts.append(
            f"the images correlate by {correlation:.2f} only; average frames, or press in smaller"
            " steps"
        )
    if drift > DRIFTED:
        doubts.append(f"a part of the image is off by {drift:.1f} px; see the map of trust")
    if folded > FOLDED:
        doubts.append(f"the motion folds {folded:.1%} of the image over, which no sample does")
    return doubts


def _contradicted(windows: Windows, u: Array, edges: Collection[Edge]) -> list[str]:
    """Edges whose stated motion the windows beside them contradict, or the field leaves at once."""
    doubts = []
    for edge in edges:
        beside = FACES[edge].pixels(windows.here.ndim)
        told = np.isfinite(windows.here[beside])
        off = ~windows.agrees[beside] | (length(windows.offset[:, *beside]) > 2 * DRIFTED)
        if (told.any() and off[told].mean() > 0.5) or _jumps(u, edge):
            doubts.append(f"{edge}: {STATED}")
    return doubts


def _jumps(u: Array, edge: Edge) -> bool:
    """Whether the field of an edge is far off the line through the rows inside of it.

    Where images contradict an edge, the field obeys it and goes over to theirs within some pixels,
    fewer than windows see.
    """
    face, (near, far) = FACES[edge], ROWS
    rows = np.moveaxis(u, 1 + face.axis(u.ndim - 1), 1)
    rows = rows[:, ::-1] if face.last else rows
    if rows.shape[1] <= far:
        return False
    change = rows[:, near] - rows[:, far]
    jump = rows[:, 0] - rows[:, near] - change * near / (far - near)
    change, jump = (np.median(f.reshape(len(u), -1), axis=1) for f in (change, jump))
    return bool(length(jump) > np.maximum(JUMP, length(change)))


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


def _standardised(f: Array, weight: Array) -> tuple[Array, Array]:
    """Windows less their weighted means, times the weights, of norm 1; and their contrasts."""
    axes = tuple(range(1, f.ndim))
    total = np.maximum(weight.sum(axis=axes, keepdims=True), TINY)
    f = weight * (f - (weight * f).sum(axis=axes, keepdims=True) / total)
    size = np.sqrt((f * f).sum(axis=axes, keepdims=True))
    contrast = size / np.sqrt(np.maximum((weight**2).sum(axis=axes, keepdims=True), TINY))
    return f / np.maximum(size, TINY), contrast.ravel()
