"""What is known of a pair of images beside them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array, Edge, Mask, faces, inside
from eofm.imaging.splines import warp_field

if TYPE_CHECKING:
    import pandas as pd


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
        n = 1 is constant.
    dead : ndarray of bool, of the images' shape, optional
        Pixels that carry no data, in both images.
    outside : tuple of {"top", "bottom", "left", "right"}
        Edges beyond which the sample goes on; only the stiffness asks.
    pixel_size : (lateral, axial, elevational)
        Sides of a pixel in any unit, of images the first two. Where they differ, smoothness
        and sigma are measured in true lengths, in units of their geometric mean.

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
            If the images, the background and the dead zones differ in size, or an edge is
            none of theirs, or the size of a pixel lacks a side.
        """
        sizes = {I1.shape, I2.shape}
        sizes |= set() if self.background is None else {self.background.shape[1:]}
        sizes |= set() if self.dead is None else {self.dead.shape}
        if len(sizes) > 1:
            listed = ", ".join(" x ".join(map(str, size)) for size in sorted(sizes))
            raise InputError(
                f"images, background and dead zones differ in size ({listed} px);"
                " crop or resample them to one"
            )
        if I1.ndim not in (2, 3):
            raise InputError(f"wanted greyscale images or volumes, got arrays of shape {I1.shape}")
        self.sides(I1.ndim)
        if strange := sorted(set(self.edges) - set(faces(I1.ndim))):
            raise InputError(f"{strange[0]}: is an edge of volumes only; leave it out")

    def sides(self, ndim: int) -> tuple[float, ...]:
        """Sides of a pixel of an image or a volume, in the unit of ``pixel_size``.

        Raises
        ------
        InputError
            If one is missing.
        """
        if len(self.pixel_size) < ndim:
            raise InputError(
                "the elevational size of the voxels is missing; say all three (lateral, axial,"
                " elevational)"
            )
        return self.pixel_size[:ndim]

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
