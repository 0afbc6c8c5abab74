"""How far an estimated displacement field is from the true one."""

import math
from collections.abc import Iterator
from functools import reduce

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array


def relative_errors(estimate: Array, truth: Array) -> dict[str, float]:
    """Relative errors in percent and largest absolute errors in px.

    Parameters
    ----------
    estimate, truth : ndarray, shape (ndim, height, width) or (ndim, depth, height, width)
        Displacement fields, px.

    Returns
    -------
    dict
        ``e_rel``, ``e_rel_u1``, ``e_rel_u2``: ``100 ||estimate - truth|| / ||truth||``
        in L2, of all components stacked and of each; ``max_error_u1``,
        ``max_error_u2``; of volumes u3 as well.

    Raises
    ------
    InputError
        If the true field is zero, so that no relative error exists.

    Examples
    --------
    >>> import numpy as np
    >>> import eofm
    >>> errors = eofm.relative_errors(np.full((2, 8, 8), 1.1), np.ones((2, 8, 8)))
    >>> round(errors["e_rel"], 6)
    10.0
    """
    if not truth.any():
        raise InputError("the true field is zero everywhere: relative errors do not exist")

    def relative(part: slice) -> float:
        size = _norm(_slices(truth[part]))
        return 100 * _norm(_differences(estimate[part], truth[part])) / size if size else np.nan

    named = {f"e_rel_u{c + 1}": relative(slice(c, c + 1)) for c in range(len(truth))}
    largest = _largest(_differences(estimate, truth))
    return {"e_rel": relative(slice(None))} | named | _named("max_error", largest)


def pixel_errors(estimate: Array, truth: Array) -> dict[str, float]:
    """Largest and median errors, and largest true displacements, all in px.

    Of the same fields as :func:`relative_errors`: ``max_error_u1``, ``max_error_u2``;
    ``median_error``, of the lengths of the differences; ``max_true_u1``, ``max_true_u2``; of
    volumes u3 as well.
    """
    largest, size = _largest(_differences(estimate, truth)), _largest(_slices(truth))
    lengths = np.stack([reduce(np.hypot, np.abs(d)) for d in _differences(estimate, truth)])
    median = {"median_error": float(np.median(lengths))}
    return _named("max_error", largest) | median | _named("max_true", size)


def _slices(u: Array) -> Iterator[Array]:
    """The field of an image, or slice by slice that of a volume, in double precision."""
    slices = np.moveaxis(u, 1, 0) if u.ndim == 4 else [u]
    return (part.astype(np.float64, copy=False) for part in slices)


def _differences(u: Array, truth: Array) -> Iterator[Array]:
    return (a - b for a, b in zip(_slices(u), _slices(truth), strict=True))


def _norm(slices: Iterator[Array]) -> float:
    return math.hypot(*map(np.linalg.norm, slices))


def _largest(slices: Iterator[Array]) -> Array:
    """Largest absolute value of each component."""
    return np.max([np.abs(part).max(axis=(1, 2)) for part in slices], axis=0)


def _named(name: str, values: Array) -> dict[str, float]:
    return {f"{name}_u{c + 1}": float(value) for c, value in enumerate(values)}
