"""How far an estimated displacement field is from the true one."""

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array


def relative_errors(estimate: Array, truth: Array) -> dict[str, float]:
    """Relative errors in percent and largest absolute errors in px.

    Parameters
    ----------
    estimate, truth : ndarray, shape (2, height, width)
        Displacement fields, px.

    Returns
    -------
    dict
        ``e_rel``, ``e_rel_u1``, ``e_rel_u2``: ``100 ||estimate - truth|| / ||truth||``
        in L2, of both components stacked and of each; ``max_error_u1``,
        ``max_error_u2``.

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
        size = np.linalg.norm(truth[part])
        return float(100 * np.linalg.norm((estimate - truth)[part]) / size) if size else np.nan

    largest = np.abs(estimate - truth).max(axis=(1, 2))
    return {
        "e_rel": relative(slice(None)),
        "e_rel_u1": relative(slice(0, 1)),
        "e_rel_u2": relative(slice(1, 2)),
        "max_error_u1": float(largest[0]),
        "max_error_u2": float(largest[1]),
    }


def pixel_errors(estimate: Array, truth: Array) -> dict[str, float]:
    """Largest and median errors, and largest true displacements, all in px.

    Of the same fields as :func:`relative_errors`: ``max_error_u1``, ``max_error_u2``;
    ``median_error``, of the lengths of the differences; ``max_true_u1``, ``max_true_u2``.
    """
    error, size = np.abs(estimate - truth), np.abs(truth).max(axis=(1, 2))
    largest = error.max(axis=(1, 2))
    return {
        "max_error_u1": float(largest[0]),
        "max_error_u2": float(largest[1]),
        "median_error": float(np.median(np.hypot(*error))),
        "max_true_u1": float(size[0]),
        "max_true_u2": float(size[1]),
    }
