"""Images as functions: normalise, resize, differentiate and evaluate them.

Images are float64 arrays of shape (height, width). Fields have shape (2, height,
width): component 0 is lateral (along columns), component 1 axial (along rows, down).
An image covers ``[0, width - 1] x [0, height - 1]``, its samples being the nodes of a
grid, so that a coarser image of the same sample has the same corners.
"""

import numpy as np
from numpy.typing import NDArray

from eofm.grid import Array
from eofm.imaging import kernels
from eofm.imaging.gaussian import mirrored, taps
from eofm.imaging.kernels import Terms


class Spline:
    """The cubic spline through an image.

    Linear interpolation is 8 times less accurate on speckle.

    Parameters
    ----------
    I : ndarray, shape (height, width)
    odd : bool
        How it goes on beyond the edges: as in a mirror, or turned by half a turn about the
        edge, ``I(-x) = 2 I(0) - I(x)``. The mirror suits images. It would bend a component
        of a displacement, which has a slope at the edges.
    """

    def __init__(self, I: Array, odd: bool = False) -> None:
        I = np.require(I, np.float64, ["C", "W"])
        self.shape, self.odd = (I.shape[0], I.shape[1]), odd
        self.c = np.empty((I.shape[0] + 3, I.shape[1] + 3))
        kernels.coefficients(self.c, I)
        if odd:
            _turn(self.c)
            _turn(self.c.T)

    def gradient(self, spacing: tuple[float, float] = (1.0, 1.0)) -> Array:
        """Gradient at the samples, shape (2, height, width), per unit of ``spacing``."""
        g = np.empty((2, *self.shape))
        kernels.slopes(g, self.c)
        return _per_length(g, spacing)

    def evaluate(self, x: Array) -> Array:
        """Values at points ``x`` = (lateral, axial), shape (2, ...), in samples.

        Points outside the image take the value of the nearest point of its border.
        """
        values, _, _ = self._sample(x.reshape(2, -1, 1), 0.0, 0)
        return values.reshape(x.shape[1:])

    def warp(self, u: Array) -> tuple[Array, NDArray[np.bool_]]:
        """The image ``I(x + u(x))``, and where ``x + u(x)`` lies inside of ``I``.

        ``u``, shape (2, height, width), is measured in samples.
        """
        values, _, inside = self._sample(u, 1.0, 0)
        return values, inside

    def warp_with_gradient(
        self, u: Array, spacing: tuple[float, float] = (1.0, 1.0)
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """``I(x + u(x))``, the gradient of ``I`` there, and where it lies inside of ``I``.

        The gradient, shape (2, height, width), is per unit of ``spacing``.
        """
        values, gradients, inside = self._sample(u, 1.0, 2)
        return values, _per_length(gradients, spacing), inside

    def resize(self, shape: tuple[int, int]) -> Array:
        """Samples on a grid of another size with the same corners, see :func:`resize`."""
        axial, lateral = (
            _terms(old, new, self.odd) for old, new in zip(self.shape, shape, strict=True)
        )
        J = np.empty(shape)
        kernels.resample(J, self.c, lateral, axial)
        return J

    def _sample(
        self, u: Array, step: float, components: int
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        shape = u.shape[1:]
        values, gradients = np.empty(shape), np.empty((components, *shape))
        inside = np.empty(shape, dtype=np.bool_)
        u = np.require(u, np.float64, ["C", "W"])
        kernels.sample(values, gradients, inside, self.c, u, step)
        return values, gradients, inside


def _per_length(g: Array, spacing: tuple[float, float]) -> Array:
    """Derivatives per sample made derivatives per unit of ``spacing``, in place."""
    for component, h in zip(g, spacing, strict=True):
        if h != 1:
            component /= h
    return g


def _turn(c: Array) -> None:
    """Make coefficients that are mirrored along axis 0 those of a spline that is odd there.

    Its second derivative is zero at the ends, where the coefficients are the samples. The
    differences are taken to the inside by the powers of the pole, whose spline is zero at the
    samples in between.
    """
    n = len(c) - 3
    if n == 1:
        return
    power = kernels.POLE ** np.arange(n)[:, None]
    far = power[-1]
    first, last = (c[2] - c[1]) / 3, (c[n - 1] - c[n]) / 3
    c[1 : n + 1] += power * (first - far * last) / (1 - far**2)
    c[1 : n + 1] += power[::-1] * (last - far * first) / (1 - far**2)
    c[0], c[n + 1], c[n + 2] = 2 * c[1] - c[2], 2 * c[n] - c[n - 1], 2 * c[n] - c[n - 2]


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
    spline = np.stack(kernels.weights(position - first)[0], axis=1)
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


def gradient(I: Array, spacing: tuple[float, float] = (1.0, 1.0)) -> Array:
    """Gradient of the cubic spline through an image, shape (2, height, width).

    ``spacing`` holds the lateral and the axial distance of the samples.
    """
    return Spline(I).gradient(spacing)


def evaluate(I: Array, x: Array) -> Array:
    """Values of an image at points ``x`` = (lateral, axial), shape (2, ...), in samples.

    Points outside the image take the value of the nearest point of its border.
    """
    return Spline(I).evaluate(x)


def evaluate_field(u: Array, x: Array) -> Array:
    """Both components of a field at points, shape (2, ...)."""
    return np.stack([Spline(c, odd=True).evaluate(x) for c in u])


def warp(I: Array, u: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The image ``I(x + u(x))``, and where ``x + u(x)`` lies inside of ``I``.

    ``u`` is measured in samples of ``I``.
    """
    return Spline(I).warp(u)


def warp_field(f: Array, u: Array) -> Array:
    """Both components of ``f(x + u(x))``, shape (2, height, width)."""
    return np.stack([Spline(c, odd=True).warp(u)[0] for c in f])


def resize(I: Array, shape: tuple[int, int], odd: bool = False) -> Array:
    """Sample an image on a grid of another size with the same corners.

    A coarser grid is preceded by a Gaussian that takes the blur of a pixel from 0.5
    samples of the fine grid to 0.5 of the coarse one. For ``odd`` see :class:`Spline`.
    """
    if shape == I.shape:
        return I
    return Spline(I, odd).resize(shape) if I.any() else np.zeros(shape)


def resize_field(u: Array, shape: tuple[int, int]) -> Array:
    """Sample both components of a field on another grid; its unit stays the same."""
    return u if shape == u.shape[1:] else np.stack([resize(c, shape, odd=True) for c in u])
