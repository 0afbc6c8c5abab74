"""What is known of a pair of images beside them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from eofm.errors import InputError
from eofm.grid import FACES, Array, Edge, Mask, faces, inside, unit_spacing
from eofm.imaging.splines import warp_field

if TYPE_CHECKING:
    import pandas as pd

# Numbers of channels of colour images, and of times that a volume so narrow would be deeper.
COLOURS, FLAT = (3, 4), 5
# Largest ratio of two sides of a pixel, and of those of a voxel in which smoothness is measured:
# across the shortest, flatter ones would be so stiff that images are lost in single precision.
LONGEST, FLATTEST = 100.0, 4.0
# What is said of a mask that leaves only what is empty.
NO_DATA = (
    "dead: no pixel outside of the mask carries data; is it the wrong way round? It covers what to"
    " leave out"
)


@dataclass(frozen=True)
class Known:
    """What is known of a pair of images beside them; all of it may be left open.

    Attributes
    ----------
    bubbles : DataFrame, optional
        Columns x1, x2, u1, u2, and x3, u3 of volumes, px, as :func:`eofm.track` returns
        them; without it there is no speckle term.
    background : ndarray, shape (2, height, width) or (3, depth, height, width), optional
        The field u_bg of eq. (Ansatz), px; without it u_bg = 0.
    edges : mapping of ndarray, shape (2, n) or (3, n, m)
        Motion ``g`` of the pixels of edges, or of faces of a volume, px, eq. (bdc_Dirichlet);
        n is the number of pixels, or 1 if that is constant. It is NaN where it is not known, as
        is the lateral component of a plate along which the sample slides.
    dead : ndarray of bool, of the images' shape, optional
        Pixels that carry no data, in both images.
    outside : tuple of {"top", "bottom", "left", "right"}
        Edges beyond which the sample goes on; only the stiffness asks.
    pixel_size : (lateral, axial, elevational)
        Sides of a pixel in any unit, of images the first two. Where they differ, smoothness
        and sigma are measured in true lengths, in units of their geometric mean; of voxels, no side
        counts as more than four times the shortest there.

    Examples
    --------
    >>> import numpy as np
    >>> import eofm
    >>> known = eofm.Known(edges={"top": np.zeros((2, 1))}, pixel_size=(3.9, 6.0))
    >>> known.bubbles is None
    True
    """

    bubbles: "pd.DataFrame | None" = None
    background: Array | None = None
    edges: Mapping[Edge, Array] = field(default_factory=dict)
    dead: Mask | None = None
    pixel_size: tuple[float, ...] = (1.0, 1.0, 1.0)
    outside: tuple[Edge, ...] = ()

    def check(self, I1: Array, I2: Array) -> None:
        """Refuse what does not fit two images.

        Raises
        ------
        InputError
            If the images are no images or volumes of one size, or the background, the dead zones
            or the motion of an edge is no field, mask or motion of theirs; see :meth:`sides`, too.
        """
        shape, ndim = I1.shape, I1.ndim
        if strange := {I1.ndim, I2.ndim} - {2, 3}:
            wrong = shape if ndim in strange else I2.shape
            raise InputError(f"wanted greyscale images or volumes, got arrays of shape {wrong}")
        if I1.shape != I2.shape:
            listed = " and ".join(" x ".join(map(str, I.shape)) for I in (I1, I2))
            raise InputError(f"the images differ in size ({listed} px); crop or resample them")
        if ndim == 3 and shape[-1] in COLOURS and min(shape[:2]) > FLAT * shape[-1]:
            raise InputError(
                f"an array of shape {shape} looks like a colour image; give one of its channels"
            )
        self.sides(ndim)
        if self.background is not None:
            _numbers("background", self.background, (ndim, *shape))
        if self.dead is not None:
            _mask(self.dead, I1, I2)
        for edge, motion in self.edges.items():
            if edge not in faces(ndim):
                known = ", ".join(faces(ndim))
                what = "a face of volumes" if edge in FACES else "no edge"
                raise InputError(f"{edge}: is {what}; those of these images are {known}")
            sizes = (ndim, *FACES[edge].sides(shape)), (ndim, *[1] * (ndim - 1))
            _numbers(edge, np.nan_to_num(motion, nan=0.0, posinf=np.inf, neginf=-np.inf), *sizes)
            if np.isnan(motion).all():
                raise InputError(f"{edge}: nothing of its motion is known; leave it out")

    def sides(self, ndim: int) -> tuple[float, ...]:
        """Sides of a pixel of an image or a volume, in the unit of ``pixel_size``.

        Raises
        ------
        InputError
            If one is missing, or they are no lengths, or one is many times as long as another.
        """
        try:
            sides = tuple(float(side) for side in self.pixel_size)
        except (TypeError, ValueError):
            sides = ()
        if len(sides) == 2 < ndim:
            raise InputError(
                "the elevational size of the voxels is missing; say all three (lateral, axial,"
                " elevational)"
            )
        if len(sides) not in {ndim, 3} or not all(0 < side < math.inf for side in sides):
            raise InputError(
                f"pixel_size: wanted positive lengths (lateral, axial), of voxels (lateral, axial,"
                f" elevational), got {self.pixel_size}"
            )
        sides = sides[:ndim]
        if max(sides) > LONGEST * min(sides):
            raise InputError(
                f"pixel_size: sides of {max(sides):g} and {min(sides):g} differ by more than"
                f" {LONGEST:g} times; check their unit, or resample the images"
            )
        return sides

    def spacing(self, ndim: int) -> tuple[float, ...]:
        """Distances of the pixels of an image or a volume in which smoothness is measured."""
        sides = self.sides(ndim)
        if ndim == 3:
            sides = tuple(min(side, FLATTEST * min(sides)) for side in sides)
        return unit_spacing(sides)

    def dead_on(self, shape: tuple[int, ...]) -> Mask:
        """Return the pixels that carry no data, of images of a shape; none if not stated."""
        return np.zeros(shape, dtype=bool) if self.dead is None else self.dead

    def motions(self, shape: tuple[int, ...]) -> tuple[Array, Array]:
        """Centres and motions of the bubbles, shape (ndim, M) each, px; none give M = 0.

        Raises
        ------
        InputError
            If a bubble lies outside of an image of a ``shape``, or moves farther than its size,
            or a column is missing.
        """
        n = len(shape)
        if self.bubbles is None:
            return np.empty((n, 0)), np.empty((n, 0))
        columns = [f"{name}{c + 1}" for name in "xu" for c in range(n)]
        if lacking := [name for name in columns if name not in self.bubbles]:
            raise InputError(f"bubbles: the column {lacking[0]} is missing; track them again")
        x, motion = np.split(self.bubbles[columns].to_numpy(dtype=float).T, 2)
        size = np.reshape(shape[::-1], (n, 1))
        bad = np.flatnonzero(~inside(shape, x) | (np.abs(motion) >= size).any(0))
        if bad.size:
            raise InputError(
                f"bubble {bad[0] + 1} of {x.shape[1]} lies or moves outside of the image of"
                f" {' x '.join(map(str, shape))} px; was the table made for another image?"
            )
        return x, motion

    def backwards(self, shape: tuple[int, ...]) -> "Known":
        """Return the same of the way back, from the second image, of a ``shape``, to the first."""
        back, u_bg = self.bubbles, self.background
        if back is not None:
            names = [(f"x{c + 1}", f"u{c + 1}") for c in range(len(shape))]
            moved = {x: back[x] + back[u] for x, u in names} | {u: -back[u] for _, u in names}
            back = back.assign(**moved)
            back = back[inside(shape, back[[x for x, _ in names]].to_numpy().T)]
        return replace(
            self,
            bubbles=back,
            background=None if u_bg is None else -warp_field(u_bg, -u_bg),
            edges={edge: -g for edge, g in self.edges.items()},
        )


def _numbers(name: str, values: Array, *shapes: tuple[int, ...]) -> None:
    """Refuse what is no array of finite numbers whose sides are those of one of some shapes."""
    values = np.asarray(values)
    sides = list(zip(*shapes, strict=True))
    fits = len(sides) == values.ndim and all(map(tuple.__contains__, sides, values.shape))
    if not fits or values.dtype.kind not in "iuf":
        wanted = " or ".join(map(str, shapes))
        raise InputError(
            f"{name}: wanted real numbers of shape {wanted}, got {values.dtype} of {values.shape}"
        )
    if not np.isfinite(values).all():
        raise InputError(f"{name}: has NaN or infinite values; replace them")


def _mask(dead: Mask, *images: Array) -> None:
    """Refuse what is no mask of some images, or leaves nothing of them."""
    values, shape = np.asarray(dead), images[0].shape
    if values.dtype != np.bool_:
        raise InputError(f"dead: wanted a mask of True and False, got {values.dtype}; compare it")
    if values.shape != shape:
        raise InputError(f"dead: has the shape {values.shape}, but the images have {shape}")
    if values.all():
        raise InputError("dead: the mask leaves no pixel; is it the wrong way round?")
    first = int(np.argmin(values))
    if all((values | (I.flat[first] == I)).all() for I in images):
        raise InputError(NO_DATA)
