"""Some windows that stand for a large image, or for a volume."""

import numpy as np

from eofm.flow.matching import BLOCK, Match
from eofm.grid import Array, Grid

# Side of the windows, and of what is larger than what has windows, px; and how many there are.
WINDOW, WINDOWS = {2: (120, 384), 3: (48, 96)}, 5
# Pixels at its sides that only the field is given: a window ends where the image goes on, and the
# field is worse there than in the image, which would make weights too small.
INNER = 2 * BLOCK
# Part of the windows that goes by the data alone, not by the roughness of the motion.
EVEN = 0.5
TINY = float(np.finfo(np.float32).tiny)


def windows(match: Match) -> list[tuple[tuple[slice, ...], Array]]:
    """The image or, where it is large, some windows, and how often each pixel counts."""
    width, large = WINDOW[match.grid.ndim]
    shape = match.grid.shape
    if max(shape) <= large:
        return [(tuple(slice(0, n) for n in shape), np.ones(shape))]
    sides = [_tiles(n, width) for n in shape]
    data, rough = _contents(match, sides)
    found = []
    for k, count in drawn(EVEN * data + (1 - EVEN) * rough, WINDOWS):
        window = tuple(side[i] for side, i in zip(sides, k, strict=True))
        found.append((window, _counts(shape, window, count)))
    return found


def _tiles(n: int, width: int) -> list[slice]:
    """Windows that cover an axis of n samples, and overlap as little as they can."""
    width = min(n, width)
    starts = np.linspace(0, n - width, -(-n // width)).round().astype(int)
    return [slice(int(start), int(start) + width) for start in starts]


def _contents(match: Match, sides: list[list[slice]]) -> tuple[Array, Array]:
    """Shares of the windows of a lattice in the squared gradient, and in that times roughness.

    Roughness is the squared second difference of the motion between blocks. What a
    weight takes away of it is seen where there are gradients.
    """
    blocks = [np.arange(0, n, BLOCK) for n in match.grid.shape]

    def blockwise(f: Array) -> Array:
        for axis, starts in enumerate(blocks):
            f = np.add.reduceat(f, starts, axis)
        return f

    data = blockwise((match.g**2).sum(0) * match.used)
    u, rough = match.u, np.zeros_like(data)
    for axis, starts in enumerate(blocks):
        u = u.take(starts, axis + 1)
    for axis, n in enumerate(data.shape):
        inner = tuple(slice(1, -1) if k == axis else slice(None) for k in range(data.ndim))
        if n > 2:
            rough[inner] += (np.diff(u, 2, axis + 1) ** 2).sum(0)
    shares = []
    for part in (data, data * rough):
        sums = np.empty([len(side) for side in sides])
        for k in np.ndindex(sums.shape):
            window = (side[i] for side, i in zip(sides, k, strict=True))
            sums[k] = part[
                tuple(slice(s.start // BLOCK, s.stop // BLOCK + 1) for s in window)
            ].sum()
        shares.append((sums + TINY) / (sums + TINY).sum())
    return shares[0], shares[1]


def drawn(share: Array, count: int) -> list[tuple[tuple[int, ...], float]]:
    """Indices of places drawn in proportion to their share, and the inverse of that probability.

    Sums over the places drawn, each times that number, are estimates of sums over all of them
    without bias (Horvitz and Thompson, J. Am. Stat. Assoc. 47, 1952). Draws are systematic: the
    middles of ``count`` equal parts of the accumulated share, with every other row backwards,
    so that neighbours do not stand for each other. A place that is met twice counts twice.

    Parameters
    ----------
    share : ndarray
        Positive, of sum 1.
    count : int
    """
    numbers = np.arange(share.size).reshape(share.shape)
    numbers[1::2] = numbers[1::2, ::-1]
    order = numbers.ravel()
    ends = np.cumsum(share.ravel()[order])
    middles = ends[-1] * (np.arange(count) + 0.5) / count
    places, times = np.unique(np.searchsorted(ends, middles), return_counts=True)
    return [
        (np.unravel_index(place, share.shape), float(n / (count * share.flat[place])))
        for place, n in zip(order[places], times, strict=True)
    ]


def _counts(shape: tuple[int, ...], window: tuple[slice, ...], count: float) -> Array:
    """``count`` on the pixels of a window, 0 near a side where the image goes on."""
    counts = np.zeros([s.stop - s.start for s in window])
    inner = (
        slice(INNER * (s.start > 0), s.stop - s.start - INNER * (s.stop < n))
        for n, s in zip(shape, window, strict=True)
    )
    counts[tuple(inner)] = count
    return counts


def cut_out(match: Match, window: tuple[slice, ...]) -> Match:
    """The images linearised as they are, in a window."""
    grid = Grid(tuple(s.stop - s.start for s in window), match.grid.spacing)
    return Match(
        grid, match.u[:, *window], match.g[:, *window], match.r[window], match.used[window]
    )
