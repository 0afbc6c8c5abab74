"""Whether the images bear an estimate out: a verdict with its reasons.

After the second image has been carried back by an estimate, small windows of both images should
match where they are, see :mod:`eofm.flow.windows`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import reduce
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from eofm.flow.windows import correlate
from eofm.grid import FACES, Array, Edge, Mask

Verdict = Literal["good", "doubtful", "failed"]

# Share of agreeing windows below which an estimate is doubtful, and has failed. Of windows that
# have nothing in common three in a hundred agree by chance, and one in four after a flow has done
# its best to make them alike.
AGREED = 0.75, 0.35
# What else raises doubts: the share of windows that contradict, the share that agree in a part of
# the image, the median correlation, the drift of a part in px, the share of pixels that are folded
# over, and that carry data; how far the images leave the motion open, and how much farther
# structures of one width have moved, px; and the shares of the image whose lines flicker, and that
# is found elsewhere.
CONTRADICTED, PARTLY, CORRELATED, DRIFTED, FOLDED, USED = 0.05, 0.5, 0.7, 0.25, 0.005, 0.1
OPEN, PULLED, FLICKERS, ASTRAY = 0.3, 0.05, 0.25, 0.005
# Slices, or rows, whose gradients are taken at once.
SLAB = 16
# Differences of images and displacements that are none.
SAME = 1e-6
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
    empty : float
        Share of the windows with data that show white noise alone, and are not in the others.
    spread, pull : float
        About how far the images leave the displacement open, and how much farther structures of
        one width have moved, px.
    flicker : float
        Share of the image whose lines flicker, and were not taken off: of tiles alone.
    unlike : float
        Share of the image that shows what the other one does not, and was left out: an instrument
        that comes in, or noise in the dark. It is told, and no reason to doubt the rest.
    astray : float
        Share of the image that is found in the other one by pixels away from where the motion says:
        an object before others, or beside a crack.
    edges : mapping of float
        By how much the images contradict the stated motion of edges, px, of those that they do.
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
    empty: float
    spread: float
    pull: float
    flicker: float
    unlike: float
    astray: float
    edges: Mapping[Edge, float] = field(default_factory=dict)

    def on(self, shape: tuple[int, ...]) -> "Trust":
        """Return the same with a map of another size, each pixel taking the nearest value."""
        if shape == self.map.shape:
            return self
        nearest = (
            np.linspace(0, old - 1, new).round().astype(np.intp)
            for old, new in zip(self.map.shape, shape, strict=True)
        )
        return replace(self, map=self.map[np.ix_(*nearest)])

    def summary(self) -> dict[str, Any]:
        """Return all but the map, for a file."""
        numbers = {f.name: getattr(self, f.name) for f in fields(self) if f.type is float}
        edges = {"edges_off": dict(self.edges)}
        return {"verdict": self.verdict, "reasons": list(self.reasons), **numbers, **edges}


class Told(NamedTuple):
    """What is known of an estimate beside windows of its images, see :class:`Trust`."""

    edges: Mapping[Edge, float] = MappingProxyType({})
    spread: float = 0.0
    pull: float = 0.0
    flicker: float = 0.0
    unlike: float = 0.0
    astray: float = 0.0


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


def judge(
    I1: Array,
    warped: Array,
    used: Mask,
    u: Array,
    told: Told = Told(),
) -> Trust:
    """Verdict on a displacement.

    Parameters
    ----------
    I1, warped : ndarray, shape (height, width) or (depth, height, width)
        The image before compression, and the one after it at ``x + u(x)``.
    used : ndarray of bool, of that shape
        Pixels that carry data: neither dead nor moved out of the image.
    u : ndarray, shape (2, ...) or (3, ...)
        In px.
    told : Told
    """
    windows = correlate(I1, warped, used)
    known = np.isfinite(windows.here)
    count = max(int(known.sum()), 1)
    trust = Trust(
        "good",
        (),
        np.where(used, windows.on_pixels(I1.shape), np.nan),
        agreeing=float(windows.agrees.sum() / count),
        contradicting=float(windows.contradicts.sum() / count),
        part=windows.least(),
        correlation=float(np.median(windows.here[known])) if known.any() else 0.0,
        drift=windows.drift(),
        folded=folds(u),
        used=float(used.mean()),
        empty=float(windows.empty.sum() / max(int((known | windows.empty).sum()), 1)),
        **told._asdict(),
    )
    said = []
    if np.allclose(I1, warped, atol=SAME) and np.allclose(u, 0, atol=SAME):
        said.append(SAME_IMAGES)
    return _judged(trust, said)


def pooled(parts: Sequence[Mapping[str, Any]], voxels: Sequence[int]) -> Trust:
    """Verdict on a field of whose parts each has a summary; its map is empty.

    The parts, of so many ``voxels``, take the place of the parts of an image.
    """
    data = [v * part["used"] for v, part in zip(voxels, parts, strict=True)]

    def mean(key: str, weights: Sequence[float]) -> float:
        total = sum(w * part[key] for w, part in zip(weights, parts, strict=True))
        return float(total / max(sum(weights), TINY))

    of_data = ("agreeing", "contradicting", "correlation", "empty", "spread", "pull", "flicker")
    shares = {key: mean(key, data) for key in (*of_data, "unlike", "astray")}
    shares |= {key: mean(key, voxels) for key in ("folded", "used")}
    shares["part"] = min((p["agreeing"] for p in parts if p["used"] > USED), default=1.0)
    shares["drift"] = max(part["drift"] for part in parts)
    # What is said of an edge is true of the whole where it is of a part.
    edges = {
        edge: max(part["edges_off"].get(edge, 0.0) for part in parts)
        for edge in FACES
        if any(edge in part["edges_off"] for part in parts)
    }
    same = all(any(SAME_IMAGES in reason for reason in part["reasons"]) for part in parts)
    trust = Trust("good", (), np.empty(0), **shares, edges=edges)
    return _judged(trust, [SAME_IMAGES] if same else [])


def _judged(trust: Trust, said: list[str]) -> Trust:
    """The same with the verdict and reasons that follow from its numbers, and what else is said."""
    failed = _failures(trust)
    doubts = said if failed else [*_unlike(trust), *_unlikely(trust), *said]
    verdict: Verdict = "failed" if failed else "doubtful" if doubts else "good"
    return replace(trust, verdict=verdict, reasons=(*failed, *doubts))


def _failures(trust: Trust) -> list[str]:
    if trust.used == 0:
        return ["no part of the image carries data; check the mask and the motion"]
    if trust.agreeing < max(AGREED[1], trust.contradicting):
        return [
            f"only {trust.agreeing:.0%} of the image match the other one after the motion; check"
            " that both show the same sample, or state its edges or a background"
        ]
    return []


def _unlike(trust: Trust) -> list[str]:
    """What windows of the images say."""
    doubts = []
    if trust.empty > 1 - AGREED[0]:
        doubts.append(
            f"{trust.empty:.0%} of the image show nothing but noise, and the motion is not known"
            " there; mask them"
        )
    if trust.used < USED:
        doubts.append(f"only {trust.used:.0%} of the image carry data; make the mask smaller")
    if trust.agreeing < AGREED[0]:
        doubts.append(
            f"only {trust.agreeing:.0%} of the image match after the motion; see the map of trust"
        )
    elif trust.part < PARTLY:
        doubts.append(
            f"in a part of the image only {trust.part:.0%} match after the motion; see the map of"
            " trust"
        )
    if trust.contradicting > CONTRADICTED:
        doubts.append(
            f"{trust.contradicting:.0%} of the image match better elsewhere; the motion may be too"
            " large, or what was stated of it wrong"
        )
    if trust.astray > ASTRAY:
        doubts.append(
            f"{trust.astray:.1%} of the image have moved elsewhere than was found, as an object"
            " before others or beside a crack; estimate that alone (roi), mask it, or press in"
            " smaller steps"
        )
    if trust.correlation < CORRELATED:
        doubts.append(
            f"the images correlate by {trust.correlation:.2f} only; average frames, or press in"
            " smaller steps"
        )
    if trust.drift > DRIFTED:
        doubts.append(f"a part of the image is off by {trust.drift:.1f} px; see the map of trust")
    return doubts


def _unlikely(trust: Trust) -> list[str]:
    """What makes a motion unlikely, though windows agree after it."""
    doubts = []
    if trust.folded > FOLDED:
        doubts.append(
            f"the motion folds {trust.folded:.1%} of the image over, which no sample does"
        )
    # A field that follows noise makes windows agree, too.
    if trust.spread > OPEN:
        doubts.append(
            f"the images leave the motion open by {trust.spread:.1f} px or so; average frames,"
            " press in smaller steps, or state edges or a background"
        )
    if trust.pull > PULLED:
        doubts.append(
            f"structures of one width have moved {trust.pull:.2f} px farther: the field is too"
            " smooth, or something stands still and pulls at it (dirt, a mesh, noise that comes"
            " back); take that off both images, or press in larger steps"
        )
    if trust.flicker > FLICKERS:
        doubts.append(
            f"slices flicker in {trust.flicker:.0%} of the volume and pull at the field, which"
            " tiles do not mend; give all slices one brightness and contrast, or cut out a region"
        )
    doubts += [
        f"{edge}: the images contradict the motion that was stated, by about {off:.2g} px; check"
        " it, and leave free what is not known ('moved free -3': the sample slides along the plate)"
        for edge, off in trust.edges.items()
    ]
    return doubts
