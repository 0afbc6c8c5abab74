"""Speckle tracking: detect large speckle formations (bubbles) and follow them.

The paper's tracker is published elsewhere; this one takes the same road. Bubbles are
the connected components of the smoothed image above a threshold, split between the
peaks of touching ones; they are matched one to one by distance, size and brightness,
and each motion is refined by registering the image in a window around the bubble, so
that bubbles which overlap or change shape are followed by what moves, not by their outline.
"""

from collections.abc import Callable
from functools import reduce

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components, min_weight_full_bipartite_matching
from scipy.spatial import KDTree
from skimage.morphology import local_maxima
from skimage.segmentation import watershed

from eofm.errors import InputError
from eofm.grid import Array, inside
from eofm.imaging.gaussian import blur
from eofm.imaging.intensity import normalise
from eofm.imaging.splines import Spline, evaluate_field, gradient
from eofm.settings import Tracking

# Deviations below this many px are not held against a bubble by its neighbours
# (Westerweel and Scarano, Exp. Fluids 39, 2005, with a value for bubbles).
AGREEMENT_FLOOR = 0.15

# The cost of leaving a bubble unmatched, in units where the gate's distance costs 1.
UNMATCHED = 1.0

# Bubbles that are assigned at once (the time of an assignment grows with their square), and
# samples of windows that are registered at once (their memory).
ASSIGNED = 500
SAMPLES = 2**17


def track(
    I1: Array,
    I2: Array,
    settings: Tracking = Tracking(),
    *,
    prediction: Array | None = None,
) -> pd.DataFrame:
    """Motion of the bubbles between two images or volumes.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width) or (depth, height, width)
        Images or volumes before and after compression.
    settings : Tracking
        What is a bubble, and what is a match.
    prediction : ndarray, shape (ndim, ...), optional
        A displacement that is about right, px, such as the background field; without
        it bubbles are sought where they were.

    Returns
    -------
    DataFrame
        One row per bubble: ``x1``, ``x2`` (centre of mass before compression) and ``u1``,
        ``u2`` (displacement), px, with ``x3`` and ``u3`` in a volume; ``area``, px^2, see
        :func:`detect`; ``brightness``, peak above the threshold with both images in [0, 1];
        ``quality``, correlation of the two windows, at most 1. Its ``attrs["found"]`` is the
        number of bubbles in the first image.

    Raises
    ------
    InputError
        If an image is constant, no bubble is found, or none can be followed.

    Examples
    --------
    >>> import numpy as np
    >>> import eofm
    >>> u = np.full((2, 60, 80), 0.5)
    >>> before, after, _ = eofm.make_phantom(u, eofm.Phantom(count=40, distance=8, seed=3))
    >>> bubbles = eofm.track(before, after)
    >>> bool(abs(bubbles.u1.median() - 0.5) < 0.02)
    True
    """
    table = followed(I1, I2, settings, prediction)
    if table.empty:
        raise InputError(
            f"none of {table.attrs['found']} bubbles could be followed; raise the gate"
            f" ({settings.gate:g} px), lower the quality ({settings.quality:g}), or give a"
            " field that predicts the motion"
        )
    return table


def followed(
    I1: Array, I2: Array, settings: Tracking, prediction: Array | None = None
) -> pd.DataFrame:
    """What `track` returns, of which no bubble may be left."""
    I1, I2 = normalise(I1, I2)
    settings.check_widths(I1.shape)
    kind = "image" if I1.ndim == 2 else "volume"
    before, after = detect(I1, settings), detect(I2, settings)
    for name, bubbles in (("before", before), ("after", after)):
        if bubbles.empty:
            raise InputError(
                f"no bubble found in the {kind} {name} compression; lower the threshold"
                f" ({settings.threshold:g}) or the least area ({settings.min_area} px^2)"
            )
    x, y = _places(before), _places(after)
    expected = np.zeros_like(x) if prediction is None else evaluate_field(prediction, x)
    i, j = assign(before, after, expected, settings.gate)
    x, expected = x[:, i], expected[:, i]
    motion, quality = register(I1, I2, x, y[:, j] - x, settings.window)
    good = (quality >= settings.quality) & (
        reduce(np.hypot, motion - expected) <= settings.gate + settings.window
    )
    good[good] = agree(x[:, good], (motion - expected)[:, good], settings)
    moved = {f"u{k}": c for k, c in enumerate(motion, 1)}
    table = before.iloc[i].assign(**moved, quality=quality)[good]
    names = [f"x{k}" for k in range(1, I1.ndim + 1)] + [*moved]
    table = table[[*names, "area", "brightness", "quality"]].reset_index(drop=True)
    table.attrs["found"] = len(before)
    return table


def _places(bubbles: pd.DataFrame) -> Array:
    """Their centres, shape (ndim, M)."""
    return bubbles.filter(regex="^x[1-3]$").sort_index(axis=1).to_numpy().T


def detect(I: Array, settings: Tracking = Tracking()) -> pd.DataFrame:
    """Bubbles of an image or a volume: columns x1, x2, ... (centre of mass), area and brightness.

    The threshold is a part of the range from the 0.5th to the 99.5th percentile.
    Bubbles that are cut by the edge count like any other. Their area in a volume, px^2, is that
    of a cut through the middle of a ball as large.
    """
    smooth = blur(I, settings.smoothing)
    low, high = np.percentile(smooth, [0.5, 99.5])
    level = low + settings.threshold * (high - low)
    # Plateaus, as of saturated bubbles, count as one peak each.
    bright = smooth > level
    peaks, _ = ndimage.label(local_maxima(smooth) & bright, np.ones([3] * I.ndim))
    regions = watershed(-smooth, peaks, mask=bright)
    seen = regions > 0
    label, height = regions[seen] - 1, (smooth - level)[seen]
    size, total = np.bincount(label).astype(float), np.bincount(label, height)
    area = size if I.ndim == 2 else np.pi * (0.75 / np.pi * size) ** (2 / 3)
    # A bubble of one row or column at the border must not be rounded out of the image.
    x = [
        np.minimum(np.bincount(label, height * x) / total, n - 1)
        for x, n in zip(np.nonzero(seen), I.shape, strict=True)
    ]
    brightness = np.zeros(len(area))
    np.maximum.at(brightness, label, height)
    places = {f"x{I.ndim - axis}": c for axis, c in enumerate(x)}
    table = pd.DataFrame(places | {"area": area, "brightness": brightness})
    kept = table.area.between(settings.min_area, settings.max_area)
    return table[kept].reset_index(drop=True)


def assign(
    before: pd.DataFrame, after: pd.DataFrame, expected: Array, gate: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """One-to-one matches of least total cost: rows of ``before`` and of ``after``.

    A match costs the squared distance from the ``expected`` displacement, shape (ndim, M),
    in units of the gate, plus the logarithmic differences in brightness and area; a
    bubble may stay without one (linear assignment, each bubble having a partner of its
    own that stands for none).
    """
    target = _places(before) + expected
    near = KDTree(target.T).sparse_distance_matrix(
        KDTree(_places(after).T), gate, output_type="coo_matrix"
    )
    i, j = near.row, near.col
    change = [
        np.abs(np.log(before[name].to_numpy()[i] / after[name].to_numpy()[j]))
        for name in ("brightness", "area")
    ]
    cost = (near.data / gate) ** 2 + 0.5 * change[0] + 0.25 * change[1]
    alone = np.arange(len(before))
    # Explicit zeros would be dropped from the sparse matrix, so every cost is raised alike.
    graph = sparse.csr_array(
        (
            1 + np.concatenate([cost, np.full(len(alone), UNMATCHED)]),
            (np.concatenate([i, alone]), np.concatenate([j, len(after) + alone])),
        ),
        shape=(len(before), len(after) + len(alone)),
    )
    # Clusters of bubbles that share no candidates are assigned apart.
    size = len(before) + len(after)
    links = sparse.coo_array((np.ones(len(i)), (i, len(before) + j)), shape=(size, size))
    cluster = connected_components(links, directed=False)[1][: len(before)]
    order = np.argsort(cluster, kind="stable")
    batch = np.searchsorted(cluster[order], cluster[order]) // ASSIGNED
    batches = np.split(order, np.flatnonzero(np.diff(batch)) + 1)
    rows, columns = np.concatenate([_assign_part(graph, some) for some in batches], axis=1)
    columns = columns[np.argsort(rows)]
    matched = columns < len(after)
    return alone[matched], columns[matched]


def register(
    I1: Array, I2: Array, x: Array, motion: Array, window: float, iterations: int = 10
) -> tuple[Array, Array]:
    """Motion of Gaussian windows by Gauss-Newton, and how well they correlate.

    Minimises ``int w(y - x) |I2(y + d) - I1(y)|^2 dy`` over ``d`` for each bubble at x, with
    w of standard deviation ``window`` px, started from ``motion`` of shape (ndim, M).

    Returns
    -------
    motion : ndarray, shape (ndim, M)
        In px.
    quality : ndarray, shape (M,)
        Weighted correlation coefficient of the two windows.
    """
    ndim, reach = I1.ndim, int(np.ceil(3 * window))
    offsets = np.mgrid[(slice(-reach, reach + 1),) * ndim][::-1].reshape(ndim, 1, -1)
    at_once = max(1, SAMPLES // offsets[0].size)
    before, after = Spline(I1), _with_gradient(I2)
    motion, quality = motion.copy(), np.empty(x.shape[1])
    for start in range(0, x.shape[1], at_once):
        some = np.s_[start : start + at_once]
        y = x[:, some, None] + offsets
        weight = np.exp(-(offsets**2).sum(0) / (2 * window**2)) * inside(I1.shape, y)
        reference = before.evaluate(y)
        for _ in range(iterations):
            moved = y + motion[:, some, None]
            w = weight * inside(I2.shape, moved)
            values, g = after(moved)
            difference = values - reference
            A = np.einsum("ikp,jkp,kp->kij", g, g, w)
            # Windows with one direction of contrast only stay where they are in the other.
            A += (1e-3 * np.trace(A, axis1=1, axis2=2) + 1e-12)[:, None, None] * np.eye(ndim)
            step = -np.linalg.solve(A, np.einsum("ikp,kp->ki", g, w * difference)[..., None])
            motion[:, some] += np.clip(step[..., 0].T, -0.5, 0.5)
        moved = y + motion[:, some, None]
        w = weight * inside(I2.shape, moved)
        quality[some] = _correlation(reference, after(moved)[0], w)
    return motion, quality


def _with_gradient(I: Array) -> Callable[[Array], tuple[Array, Array]]:
    """What evaluates an image or a volume and its gradient at points."""
    spline = Spline(I)
    if I.ndim == 3:
        return spline.evaluate_with_gradient
    # The spline through the gradient is smoother than that of the spline, but takes room.
    slopes = [Spline(c) for c in gradient(I)]
    return lambda x: (spline.evaluate(x), np.stack([c.evaluate(x) for c in slopes]))


def agree(x: Array, motion: Array, settings: Tracking) -> NDArray[np.bool_]:
    """Which motions agree with their neighbours' (normalised median test).

    Westerweel and Scarano, Exp. Fluids 39, 2005: the deviation from the median of the
    neighbours, over the median of their own deviations.
    """
    if x.shape[1] <= settings.neighbours:
        return np.ones(x.shape[1], dtype=bool)
    nearest = KDTree(x.T).query(x.T, k=settings.neighbours + 1)[1][:, 1:]
    others = motion[:, nearest]
    median = np.median(others, axis=2)
    spread = np.median(np.abs(others - median[..., None]), axis=2)
    deviation = np.abs(motion - median) / (spread + AGREEMENT_FLOOR)
    return deviation.max(0) <= settings.tolerance


def _assign_part(
    graph: sparse.csr_array, rows: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns of least total cost for some rows of a sparse matrix of costs."""
    part = graph[rows]
    columns, index = np.unique(part.indices, return_inverse=True)
    part = sparse.csr_array((part.data, index, part.indptr), shape=(len(rows), len(columns)))
    i, j = min_weight_full_bipartite_matching(part)
    return rows[i], columns[j]


def _correlation(p: Array, q: Array, w: Array) -> Array:
    total = np.maximum(w.sum(1, keepdims=True), 1e-12)
    p, q = (f - (w * f).sum(1, keepdims=True) / total for f in (p, q))
    norms = np.sqrt((w * p**2).sum(1) * (w * q**2).sum(1))
    return (w * p * q).sum(1) / np.maximum(norms, 1e-12)
