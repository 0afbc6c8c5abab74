"""Measures of strain by name, and their principal values, change of volume and maximum shear.

With the deformation gradient ``F = I + grad u`` of what was at x before compression:

==============  ===========================  ========================================
small           ``(grad u + grad u^T) / 2``  of small strains and rotations
green-lagrange  ``(F^T F - I) / 2``          unchanged by rotation afterwards
almansi         ``(I - F^-T F^-1) / 2``      rotates with the sample
hencky          ``ln(F^T F) / 2``            unchanged by rotation; of steps, adds up
==============  ===========================  ========================================

All four agree where strains and rotations are small (Holzapfel, Nonlinear Solid Mechanics, 2000,
section 2.5). Components are ordered e11, e22, (e33,) e12, (e13, e23).
"""

import math
from collections.abc import Callable, Iterator
from itertools import combinations
from typing import Literal, get_args

import numpy as np

from eofm.grid import Array

Measure = Literal["small", "green-lagrange", "almansi", "hencky"]
MEASURES: tuple[Measure, ...] = get_args(Measure)
NAMES = ("lateral", "axial", "elevational")
# Pixels whose tensors are decomposed at once, for the memory.
SLAB = 2**16


def pairs(n: int) -> list[tuple[int, int]]:
    """Indices of the components of a symmetric tensor in n dimensions, in their order."""
    return [(i, i) for i in range(n)] + list(combinations(range(n), 2))


def labels(n: int) -> list[str]:
    """Names of the components in n dimensions, as ``e11 lateral`` and ``e12 shear``."""
    return [
        f"e{i + 1}{j + 1} {NAMES[i] if i == j else 'shear'}"
        + (f" {NAMES[i]}-{NAMES[j]}" if n > 2 and i != j else "")
        for i, j in pairs(n)
    ]


def measured(G: Array, measure: Measure) -> Array:
    """Strain from the gradient of a displacement.

    Parameters
    ----------
    G : ndarray, shape (n, n, ...)
        ``G[i, j] = du_i / dx_j`` in true lengths.
    measure : {"small", "green-lagrange", "almansi", "hencky"}

    Returns
    -------
    ndarray, shape (n (n + 1) / 2, ...)
        Without unit; NaN where the measure does not exist, ``det F <= 0``.

    Examples
    --------
    >>> import numpy as np
    >>> G = np.array([[0.0, 0.0], [0.0, -0.1]])
    >>> [round(float(measured(G, name)[1]), 4) for name in MEASURES]
    [-0.1, -0.095, -0.1173, -0.1054]
    """
    n = len(G)
    if measure == "small":
        return np.stack([(G[i, j] + G[j, i]) / 2 for i, j in pairs(n)])
    e = np.empty((len(pairs(n)), *G.shape[2:]), G.dtype)
    for values, out in _slabs(G.reshape(n * n, -1), e.reshape(len(e), -1)):
        F = np.eye(n) + np.moveaxis(values.reshape(n, n, -1), -1, 0).astype(np.float64)
        tensor = _FINITE[measure](F)
        tensor[np.linalg.det(F) <= 0] = np.nan
        for k, (i, j) in enumerate(pairs(n)):
            out[k] = tensor[:, i, j]
    return e


def principal(e: Array) -> Array:
    """Principal strains, the largest first, shape (n, ...), of components of any measure."""
    n = _dimensions(e)
    found = np.empty((n, *e.shape[1:]), e.dtype)
    for values, out in _slabs(e.reshape(len(e), -1), found.reshape(n, -1)):
        out[:] = _eigenvalues(_full(values, n))[:, ::-1].T
    return found


def volume_change(e: Array, measure: Measure = "small") -> Array:
    """Change of volume per volume, of area in two dimensions: ``det F - 1``.

    The trace of small strains; of the other measures it is exact.
    """
    n = _dimensions(e)
    if measure == "small":
        return e[:n].sum(axis=0)
    if measure == "hencky":
        return np.expm1(e[:n].sum(axis=0))
    found = np.empty(e.shape[1:], e.dtype)
    for values, out in _slabs(e.reshape(len(e), -1), found.reshape(1, -1)):
        sign = 1 if measure == "green-lagrange" else -1
        square = np.linalg.det(np.eye(n) + 2 * sign * _full(values, n))
        with np.errstate(invalid="ignore"):
            out[0] = np.sqrt(square) ** sign - 1
    return found


def maximum_shear(e: Array) -> Array:
    """Largest shear strain in any direction: half of the difference of the extreme principal ones.

    As e12 it is that of the tensor, half of the change of a right angle.
    """
    values = principal(e)
    return (values[0] - values[-1]) / 2


def invariants(e: Array, measure: Measure) -> dict[str, Array]:
    """Principal strains, change of volume and maximum shear by their labels."""
    values = principal(e)
    named = {f"principal {k + 1}": value for k, value in enumerate(values)}
    space = "volume" if len(values) == 3 else "area in the plane"
    return named | {
        f"change of {space}": volume_change(e, measure),
        "maximum shear": (values[0] - values[-1]) / 2,
    }


def _dimensions(e: Array) -> int:
    return (math.isqrt(1 + 8 * len(e)) - 1) // 2


def _slabs(values: Array, out: Array) -> Iterator[tuple[Array, Array]]:
    """Parts of two arrays whose last axis is the pixels."""
    for start in range(0, values.shape[-1], SLAB):
        yield values[..., start : start + SLAB], out[..., start : start + SLAB]


def _full(e: Array, n: int) -> Array:
    """Tensors, shape (pixels, n, n), of components, shape (components, pixels)."""
    full = np.empty((e.shape[1], n, n))
    for k, (i, j) in enumerate(pairs(n)):
        full[:, i, j] = full[:, j, i] = e[k]
    return full


def _eigenvalues(tensors: Array) -> Array:
    """Eigenvalues, ascending; NaN of a tensor that has one."""
    known = np.isfinite(tensors).all(axis=(1, 2))
    values = np.full(tensors.shape[:2], np.nan)
    values[known] = np.linalg.eigvalsh(tensors[known])
    return values


def _green_lagrange(F: Array) -> Array:
    return (F.swapaxes(1, 2) @ F - np.eye(F.shape[1])) / 2


def _almansi(F: Array) -> Array:
    # Where F has no inverse the caller puts NaN.
    regular = np.where((np.linalg.det(F) > 0)[:, None, None], F, np.eye(F.shape[1]))
    inverse = np.linalg.inv(regular)
    return (np.eye(F.shape[1]) - inverse.swapaxes(1, 2) @ inverse) / 2


def _hencky(F: Array) -> Array:
    squares, axes = np.linalg.eigh(F.swapaxes(1, 2) @ F)
    logarithms = np.log(np.maximum(squares, np.finfo(np.float64).tiny)) / 2
    return (axes * logarithms[:, None]) @ axes.swapaxes(1, 2)


_FINITE: dict[str, Callable[[Array], Array]] = {
    "green-lagrange": _green_lagrange,
    "almansi": _almansi,
    "hencky": _hencky,
}
