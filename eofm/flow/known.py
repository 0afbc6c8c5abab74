"""What is known of a pair of images beside them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from eofm.errors import InputError
from eofm.grid import Array, Edge, Mask, inside
from eofm.imaging.splines import warp_field

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Known:
    """What is known of a pair of images beside them; all of it may be left open.

    Attributes
    ----------
    bubbles : DataFrame, optional
        Columns x1, x2, u1, u2, px, as :func:`eofm.track` returns them; without it there is
        no speckle term.
    background : ndarray, shape (2, height, width), optional
        The field u_bg of eq. (Ansatz), px; without it u_bg = 0.
    edges : mapping of ndarray, shape (2, n)
        Motion ``g`` of the n pixels of edges, px, eq. (bdc_Dirichlet); n = 1 is constant.
    dead : ndarray of bool, shape (height, width), optional
        Pixels that carry no data, in both images.
    outside : tuple of {"top", "bottom", "left", "right"}
        Edges beyond which the sample goes on; only the stiffness asks.
    pixel_size : (lateral, axial)
        Sides of a pixel in any unit. Where they differ, smoothness and sigma are measured
        in true lengths, in units of their geometric mean.

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
    pixel_size: tuple[float, float] = (1.0, 1.0)
    outside: tuple[Edge, ...] = ()

    def check(self, I1: Array, I2: Array) -> None:
        """Refuse what does not fit two images.

        Raises
        ------
        InputError
            If the images, the background and the dead zones differ in size.
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

    def motions(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        """Centres and motions of the bubbles, shape (2, M) each, px; none give M = 0.

        Raises
        ------
        InputError
            If a bubble lies outside of an image of a ``shape``, or moves farther than its size.
        """
        if self.bubbles is None:
            return np.empty((2, 0)), np.empty((2, 0))
        table = self.bubbles[["x1", "x2", "u1", "u2"]].to_numpy(dtype=float)
        x, motion = np.split(table.T, 2)
        size = np.reshape(shape[::-1], (2, 1))
        bad = np.flatnonzero(~inside(shape, x) | (np.abs(motion) >= size).any(0))
        if bad.size:
            raise InputError(
                f"bubble {bad[0] + 1} of {x.shape[1]} lies or moves outside of the image of"
                f" {shape[0]} x {shape[1]} px; was the table made for another image?"
            )
        return x, motion

    def backwards(self, shape: tuple[int, int]) -> "Known":
        """Return the same of the way back, from the second image, of a ``shape``, to the first."""
        back, u_bg = self.bubbles, self.background
        if back is not None:
            back = back.assign(x1=back.x1 + back.u1, x2=back.x2 + back.u2, u1=-back.u1, u2=-back.u2)
            back = back[inside(shape, back[["x1", "x2"]].to_numpy().T)]
        return replace(
            self,
            bubbles=back,
            background=None if u_bg is None else -warp_field(u_bg, -u_bg),
            edges={edge: -g for edge, g in self.edges.items()},
        )
