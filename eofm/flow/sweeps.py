"""The smoother of :mod:`eofm.flow.hierarchy`: steps that go through a grid together.

Memory, and the calls on small grids, are what takes time. So several steps go together, each some
rows (of volumes slices) behind the one before: what they share stays in the cache. As x and y are
overwritten in turn, a node may be a step ahead of its neighbours, but never two.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from eofm.compiled import share
from eofm.flow.operator import Operator, Real

# Steps that go together, and rows of a slab of large grids, which one thread does.
TOGETHER, SLAB = 4, 64


@cache
def chebyshev_weights(steps: range, precision: np.dtype) -> Real:
    """Those of step 1, 2 and so on, c1 and c2, see :func:`smooth`, shape (steps, 2)."""
    k = np.array(steps)
    c1, c2 = (2 * k - 3) / (2 * k + 1), (8 * k - 4) / (2 * k + 1)
    return np.stack([np.maximum(0.0, c1), c2], axis=1).astype(precision)


def smooth(
    sweep: Callable[..., None],
    x: Real,
    y: Real,
    b: Real,
    steps: range,
    from_zero: bool,
    K: Operator,
) -> tuple[Real, Real]:
    """Do steps of the Chebyshev iteration from x, and return the last iterate and the one before.

    A step overwrites the field y, the iterate before x, by the iterate after it, which is
    ``x + c1 (x - y) + c2 D^-1 (b - K x)``, where D is A plus the sum over each row of
    ``|alpha R|``. Thus K <= D (Gershgorin for R, Jensen for the pointwise term): no
    eigenvalue of D^-1 K exceeds 1. Steps count from 1; one from zero makes x zero.

    Parameters
    ----------
    sweep : compiled loop
        That of the grid's dimension.
    x, y : ndarray
        Fields, the present and the last iterate; both are overwritten.
    b : ndarray
        Functional.
    steps : range
    from_zero : bool
        Whether x and y count as zero, whatever they hold.
    K : Operator
    """
    reach = 2 if K.bending else 1
    for first in range(0, len(steps), TOGETHER):
        some = steps[first : first + TOGETHER]
        c = chebyshev_weights(some, x.dtype)
        zero = from_zero and first == 0
        for slabs in _slabs(K.shape[0], len(some), reach):
            if len(slabs):
                share(sweep, len(slabs), b.size, slabs, reach, x, y, b, c, zero, K)
        if len(some) % 2:
            x, y = y, x
    return x, y


@cache
def _slabs(rows: int, steps: int, reach: int) -> list[NDArray[np.intp]]:
    """Rows that each step does in a slab: of slabs for threads, and then of what is between.

    Each step of a slab ends ``reach`` rows before the last one, as it needs that many
    neighbours; between two slabs it does as many more. Arrays of shape (slabs, steps, 2).
    """
    least = 2 * reach * steps
    count = max(1, min(2, rows // least), rows // max(SLAB, least))
    cuts = np.array([rows * s // count for s in range(count + 1)])
    back = reach * np.arange(steps)
    low = cuts[:-1, None] + np.where(np.arange(count)[:, None] > 0, back, 0)
    high = cuts[1:, None] - np.where(np.arange(count)[:, None] < count - 1, back, 0)
    inner = cuts[1:-1, None]
    return [np.stack([low, high], axis=2), np.stack([inner - back, inner + back], axis=2)]
