"""One grey scale for two volumes that are larger than the memory, from some passes over them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eofm.grid import Array, Mask
from eofm.imaging.defects import (
    BRIGHT,
    IMPULSE,
    LIGHT,
    LINE,
    NEIGHBOURHOOD,
    PEAK,
    RARE,
    Heights,
    Levels,
    bumps,
    defects,
    filled,
    peaks,
)
from eofm.imaging.intensity import normalise
from eofm.io import windows

# Steps of the grey scale to which quantiles are counted.
STEPS = 2**16
# How far pixels decide on each other's being a defect, px.
REACH = int(4 * NEIGHBOURHOOD)

Window = tuple[slice, ...]
# Gives a window of the image before (0) or after (1), and where it shows the detector.
Raw = Callable[[int, Window], Array]
Dead = Callable[[int, Window], Mask]


def grown(window: Window, margin: int, shape: tuple[int, ...]) -> tuple[Window, Window]:
    """A window with a margin, as far as there is one, and where the window is in it."""
    sides = list(zip(window, shape, strict=True))
    around = tuple(slice(max(w.start - margin, 0), min(w.stop + margin, n)) for w, n in sides)
    pairs = zip(window, around, strict=True)
    return around, tuple(slice(w.start - a.start, w.stop - a.start) for w, a in pairs)


@dataclass(frozen=True)
class Greys:
    """How two images become those that are compared, alike in all parts of them.

    Attributes
    ----------
    limits : (float, float)
        Intensities that become 0 and 1.
    scale : (float, float)
        The same, on which defects are told.
    levels : (Levels or None, Levels or None)
        Of images that have defects.
    """

    limits: tuple[float, float]
    scale: tuple[float, float]
    levels: tuple[Levels | None, Levels | None]

    @classmethod
    def of(
        cls,
        raw: Raw,
        shape: tuple[int, ...],
        most: int,
        robust: bool,
        limits: tuple[float, float] | None = None,
    ) -> "Greys":
        """What :func:`eofm.flow.images.Images` does, from windows of ``most`` pixels.

        Raises
        ------
        InputError
            If an image is constant, or a grey scale is lost in rounding.
        """
        extremes = np.stack([_extremes(raw, k, shape, most) for k in (0, 1)])
        hollow = extremes.reshape(2, *[1] * (len(shape) - 1), 2)
        normalise(hollow[0], hollow[1], None if robust else limits)
        scale = float(extremes.min()), float(extremes.max())
        levels: list[Levels | None] = [None, None]
        for k in (0, 1) if robust else ():
            levels[k] = _levels(partial(_on_scale, raw, scale, k), shape, most)
        found = cls(scale, scale, (levels[0], levels[1]))
        if limits is None and any(levels):
            parts = ((k, window) for k in (0, 1) for window in windows(shape, most))
            live = (raw(k, w)[~found.dead(raw, k, w, shape)] for k, w in parts)
            seen = [(v.min(), v.max()) for v in live if v.size]
            low, high = min(a for a, _ in seen), max(b for _, b in seen)
            limits = float(low), float(high)
        return cls(limits or scale, scale, found.levels)

    def dead(self, raw: Raw, k: int, window: Window, shape: tuple[int, ...]) -> Mask:
        """Pixels of a window of image k that show the detector, from those around it."""
        levels = self.levels[k]
        if levels is None:
            return np.zeros([w.stop - w.start for w in window], dtype=bool)
        around, inner = grown(window, REACH, shape)
        return defects(_scaled(raw(k, around), self.scale), levels)[inner]

    def read(
        self, raw: Raw, dead: Dead, k: int, window: Window, shape: tuple[int, ...]
    ) -> tuple[Array, Mask]:
        """A window of image k, and where it shows the sample, as ``dead`` says."""
        if self.levels[k] is None:
            I = _scaled(raw(k, window), self.limits)
            return I, np.ones(I.shape, dtype=bool)
        around, inner = grown(window, LINE, shape)
        off = dead(k, around)
        I = _scaled(filled(raw(k, around), off), self.limits)
        return np.ascontiguousarray(I[inner]), ~off[inner]

    def summary(self) -> dict[str, Any]:
        """Return all of it, for a file."""
        levels = [None if each is None else [float(v) for v in each] for each in self.levels]
        return {"limits": list(self.limits), "scale": list(self.scale), "levels": levels}

    @classmethod
    def parse(cls, said: dict[str, Any]) -> "Greys":
        """Return what :meth:`summary` says."""
        first, second = (None if each is None else Levels(*each) for each in said["levels"])
        return cls(tuple(said["limits"]), tuple(said["scale"]), (first, second))


def _scaled(I: Array, limits: tuple[float, float]) -> Array:
    low, high = limits
    J = I - low
    J /= high - low
    return J


def _on_scale(raw: Raw, scale: tuple[float, float], k: int, window: Window) -> Array:
    return _scaled(raw(k, window), scale)


def _extremes(raw: Raw, k: int, shape: tuple[int, ...], most: int) -> tuple[float, float]:
    low, high = np.inf, -np.inf
    for window in windows(shape, most):
        part = raw(k, window)
        low, high = min(low, float(part.min())), max(high, float(part.max()))
    return low, high


def _levels(read: Callable[[Window], Array], shape: tuple[int, ...], most: int) -> Levels | None:
    """Those of an image from 0 to 1, if there are defects in it."""
    values, every, single, flat, steep = (np.zeros(STEPS + 1, np.int64) for _ in range(5))
    size, steepest = int(np.prod(shape)), 2.0 * len(shape)
    for window in windows(shape, most):
        around, inner = grown(window, PEAK - 1, shape)
        I = read(around)
        steep += _counts(bumps(I)[inner] / steepest)
        for counts, found in zip((every, single), peaks(I), strict=True):
            counts += _counts(I[inner][found[inner]])
        for axis in range(I.ndim):
            along = np.moveaxis(I, axis, 0)
            flat += _counts(along[1:][np.diff(along, axis=0) == 0])
        values += _counts(I[inner])
    median = _quantile(values, 0.5)
    for counts in (every, single, flat):
        counts[: int(STEPS * median) + 1] = 0
    if not every.any():
        return None
    heights = Heights(
        *(_quantile(f, part) - median for f, part in ((every, 0.75), (single, 0.5))),
        *(_quantile(values, part) - median for part in (BRIGHT, LIGHT, 1.0)),
    )
    highlight = heights.of_highlights(int(single.sum()), shape)
    lines = bool(flat.sum() >= LINE - 1)
    if highlight > heights.largest:
        highlight = np.inf
    bump = IMPULSE * steepest * _quantile(steep, 0.75)
    if not 0 < steep[int(STEPS * bump / steepest) + 1 :].sum() < 2 * RARE * size:
        bump = np.inf
    levels, marked, alone = Levels(median, highlight, lines, bump), 0, 0
    for window in windows(shape, most) if levels.any else ():
        around, inner = grown(window, REACH, shape)
        I = read(around)
        marked += int(np.count_nonzero(levels.marked(I)[inner]))
        alone += int(np.count_nonzero(levels.single(I)[inner]))
    if not 0 < marked < RARE * size:
        levels = levels._replace(highlight=np.inf, lines=False)
    if not 0 < alone < RARE * size:
        levels = levels._replace(bump=np.inf)
    return levels if levels.any else None


def _counts(I: Array) -> NDArray[np.int64]:
    """How many values from 0 to 1 are in each step."""
    return np.bincount((STEPS * I).astype(np.int64).ravel(), minlength=STEPS + 1)


def _quantile(counts: NDArray[np.int64], part: float) -> float:
    """The middle of the step of the grey scale below which a part of the pixels lies."""
    total = np.cumsum(counts)
    return (int(np.searchsorted(total, part * total[-1])) + 0.5) / STEPS
