"""Images and volumes as functions: resize, differentiate and evaluate them.

Images are float64 arrays of shape (height, width), volumes float32 arrays of shape (depth,
height, width). Fields have one axis more in front: component 0 is lateral (along columns),
component 1 axial (along rows, down), component 2 elevational (along slices). An image covers
``[0, width - 1] x [0, height - 1]``, its samples being the nodes of a grid, so that a coarser
image of the same sample has the same corners.
"""

import numpy as np
from numpy.typing import ArrayLike

from eofm.grid import Array, Mask, precision
from eofm.imaging import kernels, sampling
from eofm.imaging.gaussian import mirrored, taps
from eofm.imaging.sums import Terms, resample

# Samples beyond which coefficients do not feel where a part of an image ends, to single precision.
HALO = 12


class Spline:
    """The cubic spline through an image or a volume.

    Linear interpolation is 8 times less accurate on speckle.

    Parameters
    ----------
    I : ndarray, shape (height, width) or (depth, height, width)
    odd : bool
        How it goes on beyond the edges: as in a mirror, or turned by half a turn about the
        edge, ``I(-x) = 2 I(0) - I(x)``. A mirror levels what has a slope at the edges, as
        displacements do, and images.
    """

    def __init__(self, I: Array, odd: bool = False) -> None:
        self.shape, self.ndim, self.odd = I.shape, I.ndim, odd
        self.c = np.empty([n + 3 for n in I.shape], precision(I.ndim))
        kernels.coefficients(self.c, np.require(I, self.c.dtype, ["C", "W"]))
        if odd:
            for axis in range(I.ndim):
                kernels.turn(self.c, axis)

    def gradient(self, spacing: ArrayLike = 1.0) -> Array:
        """Gradient at the samples, shape (ndim, ...), per unit of ``spacing``."""
        g = np.empty((self.ndim, *self.shape), self.c.dtype)
        kernels.slopes(g, self.c)
        return _per_length(g, spacing)

    def evaluate(self, x: Array) -> Array:
        """Values at points ``x`` = (lateral, axial, ...), shape (ndim, ...), in samples.

        Points outside the image take the value of the nearest point of its border.
        """
        values, _, _ = self._sample(self._points(x), 0.0, 0)
        return values.reshape(x.shape[1:])

    def evaluate_with_gradient(self, x: Array) -> tuple[Array, Array]:
        """Values at points, and the gradient there, of the shape of x."""
        values, gradients, _ = self._sample(self._points(x), 0.0, self.ndim)
        return values.reshape(x.shape[1:]), gradients.reshape(x.shape)

    def warp(self, u: Array, out: Array | None = None) -> tuple[Array, Mask]:
        """The image ``I(x + u(x))``, and where ``x + u(x)`` lies inside of ``I``.

        ``u``, shape (ndim, ...), is measured in samples. The image is written to ``out`` if given.
        """
        values, _, inside = self._sample(np.asarray(u, self.c.dtype), 1.0, 0, out)
        return values, inside

    def warp_with_gradient(self, u: Array, spacing: ArrayLike = 1.0) -> tuple[Array, Array, Mask]:
        """``I(x + u(x))``, the gradient of ``I`` there, and where it lies inside of ``I``.

        The gradient, of the shape of u, is per unit of ``spacing``.
        """
        values, gradients, inside = self._sample(np.asarray(u, self.c.dtype), 1.0, self.ndim)
        return values, _per_length(gradients, spacing), inside

    def resize(self, shape: tuple[int, ...], out: Array | None = None) -> Array:
        """Samples on a grid of another size with the same corners, see :func:`resize`."""
        J = np.empty(shape, self.c.dtype) if out is None else out
        sides = zip(self.shape, shape, strict=True)
        resample(J, self.c, [_terms(old, new, self.odd) for old, new in sides])
        return J

    def _points(self, x: Array) -> Array:
        return np.asarray(x, np.float64).reshape(self.ndim, -1, *[1] * (self.ndim - 1))

    def _sample(
        self, u: Array, step: float, components: int, out: Array | None = None
    ) -> tuple[Array, Array, Mask]:
        shape = u.shape[1:]
        values = np.empty(shape, self.c.dtype) if out is None else out
        gradients = np.empty((components, *shape), self.c.dtype)
        inside = np.empty(shape, dtype=np.bool_)
        u = np.require(u, requirements=["C", "W"])
        sampling.sample(values, gradients, inside, self.c, u, step)
        return values, gradients, inside


def _per_length(g: Array, spacing: ArrayLike) -> Array:
    """Derivatives per sample made derivatives per unit of ``spacing``, in place."""
    for component, h in zip(g, np.broadcast_to(spacing, len(g)), strict=True):
        if h != 1:
            component /= float(h)
    return g


def _terms(old: int, new: int, odd: bool) -> Terms:
    """Which coefficients make a sample of an axis resized from old to new samples.

    The weights are those of the spline, after the
    Gaussian of :func:`resize`; filters of images that are mirrored or odd commute, so that
    it may act on coefficients.
    """
    f = (old - 1) / (new - 1)
    offsets, gauss = taps(0.5 * np.sqrt(max(f**2 - 1, 0)))
    position = f * np.arange(new)
    first = np.minimum(position.astype(np.intp), old - 2)
    spline = np.stack(sampling.weights(position - first)[0], axis=1)
    w = np.zeros((new, 3 + len(gauss)))
    for k, g in enumerate(gauss):
        w[:, k : k + 4] += g * spline
    at, copies = mirrored(first[:, None] + np.arange(offsets[0] - 1, offsets[-1] + 3), old)
    if odd:  # copy k is turned where k is odd, and raised k times by the difference of the ends
        turned = copies % 2
        lower, upper = np.sum(w * (turned - copies), 1), np.sum(w * (turned + copies), 1)
        w = np.column_stack([np.where(turned, -w, w), lower, upper])
        at = np.column_stack([at, np.zeros_like(first), np.full_like(first, old - 1)])
    return Terms(at + 1, w)


def gradient(I: Array, spacing: ArrayLike = 1.0) -> Array:
    """Gradient of the cubic spline through an image or a volume, shape (ndim, ...).

    ``spacing`` holds the distances of the samples: lateral, axial, ...
    """
    return Spline(I).gradient(spacing)


def evaluate(I: Array, x: Array) -> Array:
    """Values at points ``x`` = (lateral, axial, ...), shape (ndim, ...), in samples.

    Points outside the image take the value of the nearest point of its border.
    """
    return Spline(I).evaluate(x)


def evaluate_field(u: Array, x: Array) -> Array:
    """All components of a field at points, shape (ndim, ...)."""
    return np.stack([Spline(c, odd=True).evaluate(x) for c in u])


def warp(I: Array, u: Array) -> tuple[Array, Mask]:
    """The image ``I(x + u(x))``, and where ``x + u(x)`` lies inside of ``I``.

    ``u`` is measured in samples of ``I``.
    """
    return Spline(I).warp(u)


def warp_field(f: Array, u: Array) -> Array:
    """All components of ``f(x + u(x))``, of the shape of f."""
    warped = np.empty(f.shape, precision(f.ndim - 1))
    for c, out in zip(f, warped, strict=True):
        Spline(c, odd=True).warp(u, out)
    return warped


def resize(I: Array, shape: tuple[int, ...], odd: bool = False) -> Array:
    """Sample an image or a volume on a grid of another size with the same corners.

    A coarser grid is preceded by a Gaussian that takes the blur of a pixel from 0.5
    samples of the fine grid to 0.5 of the coarse one. For ``odd`` see :class:`Spline`.
    """
    return I if shape == I.shape else _resized(I, np.empty(shape, precision(I.ndim)), odd)


def resize_field(u: Array, shape: tuple[int, ...]) -> Array:
    """Sample all components of a field on another grid; its unit stays the same."""
    if shape == u.shape[1:]:
        return u
    resized = np.empty((len(u), *shape), precision(u.ndim - 1))
    for c, out in zip(u, resized, strict=True):
        _resized(c, out, odd=True)
    return resized


def needed(
    old: tuple[int, ...], new: tuple[int, ...], window: tuple[slice, ...]
) -> tuple[slice, ...]:
    """The part of an image of an ``old`` shape that a window of it on a ``new`` grid asks for."""
    parts = []
    for n, m, part in zip(old, new, window, strict=True):
        at = _terms(n, m, False).at[part]
        parts.append(slice(max(int(at.min()) - HALO, 0), min(int(at.max()) + HALO, n)))
    return tuple(parts)


def resize_part(
    I: Array,
    part: tuple[slice, ...],
    old: tuple[int, ...],
    new: tuple[int, ...],
    window: tuple[slice, ...],
    odd: bool = False,
) -> Array:
    """A window of what :func:`resize` makes of an image of which only a part is there.

    Parameters
    ----------
    I : ndarray
        That ``part`` of an image of an ``old`` shape, which has to hold what is `needed`.
    new : tuple of int
        Shape of the other grid, which has the same corners.
    window : tuple of slice
        Wanted of it.

    Examples
    --------
    >>> import numpy as np
    >>> I = np.random.default_rng(1).random((90, 70))
    >>> new, window = (46, 36), (slice(20, 30), slice(0, 36))
    >>> part = needed(I.shape, new, window)
    >>> some = resize_part(I[part], part, I.shape, new, window)
    >>> bool(np.allclose(some, resize(I, new)[window], atol=1e-6))
    True
    """
    terms = []
    for n, m, here, wanted in zip(old, new, part, window, strict=True):
        at, w = _terms(n, m, odd)
        # What lies outside of the part has no weight: the ends, where the window is inside.
        inside = np.clip(at[wanted] - here.start, 0, here.stop - here.start + 2)
        terms.append(Terms(inside, w[wanted]))
    spline = Spline(I, odd)
    J = np.empty([w.stop - w.start for w in window], spline.c.dtype)
    resample(J, spline.c, terms)
    return J


def _resized(I: Array, out: Array, odd: bool) -> Array:
    if I.any():
        return Spline(I, odd).resize(out.shape, out)
    out[:] = 0
    return out
