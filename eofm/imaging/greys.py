"""One grey scale for two volumes that are larger than the memory, from some passes over them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eofm.grid import Array, Mask
from eofm.imaging.intensity import (
    HIGHLIGHT,
    LINE,
    PEAK,
    RARE,
    Levels,
    defects,
    filled,
    normalise,
)
from eofm.io import windows

# Steps of the grey scale to which quantiles are counted.
STEPS = 2**16

Window = tuple[slice, ...]
# Gives a window of the image before (0) or after (1).
Raw = Callable[[int, Window], Array]


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
        """What :func:`eofm.flow.problem.sampled_pairs` does, from windows of ``most`` pixels.

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
            live = (found._live(raw, k, w, shape) for k in (0, 1) for w in windows(shape, most))
            seen = [(v.min(), v.max()) for v in live if v.size]
            low, high = min(a for a, _ in seen), max(b for _, b in seen)
            limits = float(low), float(high)
        return cls(limits or scale, scale, found.levels)

    def read(self, raw: Raw, k: int, window: Window, shape: tuple[int, ...]) -> tuple[Array, Mask]:
        """A window of image k, and where it shows the sample."""
        levels = self.levels[k]
        if levels is None:
            I = _scaled(raw(k, window), self.limits)
            return I, np.ones(I.shape, dtype=bool)
        around, inner = grown(window, LINE, shape)
        I = raw(k, around)
        dead = defects(_scaled(I, self.scale), levels)
        I = _scaled(filled(I, dead), self.limits)
        return np.ascontiguousarray(I[inner]), ~dead[inner]

    def _live(self, raw: Raw, k: int, window: Window, shape: tuple[int, ...]) -> Array:
        """Intensities in a window that show the sample."""
        around, inner = grown(window, LINE if self.levels[k] else 0, shape)
        I, levels = raw(k, around), self.levels[k]
        dead = defects(_scaled(I, self.scale), levels) if levels else np.zeros(I.shape, bool)
        return I[inner][~dead[inner]]

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
    from scipy import ndimage

    values, peaks = np.zeros(STEPS + 1, np.int64), np.zeros(STEPS + 1, np.int64)
    top = 0
    for window in windows(shape, most):
        around, inner = grown(window, PEAK // 2, shape)
        I = read(around)
        peak = (ndimage.maximum_filter(I, PEAK) <= I)[inner]
        I = I[inner]
        step = (STEPS * I).astype(np.int64)
        values += np.bincount(step.ravel(), minlength=STEPS + 1)
        peaks += np.bincount(step[peak], minlength=STEPS + 1)
        top += int(np.count_nonzero(I == 1))
    median = _quantile(values, 0.5)
    peaks[: int(STEPS * median) + 1] = 0
    if not peaks.any():
        return None
    highlight = HIGHLIGHT * (_quantile(peaks, 0.75) - median)
    if median + highlight >= 1 and top < LINE:
        return None
    highest = 0.0
    for window in windows(shape, most):
        above = read(window) - median
        highest = max(highest, float(np.max(above, where=above <= highlight, initial=0.0)))
    levels, count = Levels(median, highlight, highest), 0
    for window in windows(shape, most):
        around, inner = grown(window, LINE, shape)
        count += int(np.count_nonzero(levels.marked(read(around))[inner]))
    return levels if 0 < count < RARE * np.prod(shape) else None


def _quantile(counts: NDArray[np.int64], part: float) -> float:
    """The middle of the step of the grey scale below which a part of the pixels lies."""
    total = np.cumsum(counts)
    return (int(np.searchsorted(total, part * total[-1])) + 0.5) / STEPS
