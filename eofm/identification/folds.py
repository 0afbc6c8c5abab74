"""Whole bubbles held out: what a field that has not seen them gets wrong about their motion.

Blocks of pixels cut bubbles, and what half of a bubble gets wrong, as it moves without being
strained, its other half does too: such blocks ask for too little smoothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from skimage.feature import peak_local_max
from skimage.segmentation import watershed

from eofm.flow.found import Estimate
from eofm.flow.functional import Pointwise, Quadratic
from eofm.flow.matching import Match
from eofm.flow.multigrid import multigrid
from eofm.grid import Array, Mask
from eofm.imaging.gaussian import blur

# Width of the average of the squared gradients whose maxima are bubbles, and their distance, px.
WIDTH, DISTANCE = 2.0, 5
COUNT = 4
# Part of the image's mean data term that is added to all: a fold may leave black areas.
RIDGE = 1e-9
# Change of v by the last iteration of a solve, px.
ACCURACY = 1e-2


@dataclass(frozen=True)
class Folds:
    """The bubbles of linearised images, in ``COUNT`` parts that are held out in turn.

    Attributes
    ----------
    match : Match
    seed : int
    """

    match: Match
    seed: int = 0

    @cached_property
    def cells(self) -> NDArray[np.int64]:
        """Number of the bubble to which each pixel belongs, from 0, shape (height, width)."""
        energy = blur((self.match.g**2).sum(0) * self.match.used, WIDTH)
        peaks = peak_local_max(energy, min_distance=DISTANCE, exclude_border=False)
        markers = np.zeros(energy.shape, dtype=np.int64)
        markers[*peaks.T] = np.arange(1, len(peaks) + 1)
        found: NDArray[np.int64] = watershed(-energy, markers) - 1
        return found

    @cached_property
    def fold(self) -> NDArray[np.int64]:
        """Which part holds each bubble."""
        count = int(self.cells.max()) + 1
        return np.random.default_rng(self.seed).permutation(count) % COUNT

    @cached_property
    def masks(self) -> list[Mask]:
        """Pixels held out in each part."""
        return [self.fold[self.cells] == k for k in range(COUNT)]

    def losses(self, fields: list[Array]) -> Array:
        """What a shift of each bubble would still take off the misfit, in variances of the noise.

        That is ``s . A^-1 s`` with ``A`` and ``s`` the sums of ``g g`` and ``g r`` over the
        bubble, and ``r`` what the field that has not seen it leaves. Its mean is 2, the number
        of components, where noise alone is left, and no other error of the bubble's look counts.

        Parameters
        ----------
        fields : list of ndarray, shape (2, height, width)
            The displacement for each part held out, true lengths.
        """
        used, g = self.match.used, self.match.g
        r = np.select(self.masks, [self.match.residual(u) for u in fields])
        label, count = self.cells[used], self.fold.size

        def total(f: Array) -> Array:
            return np.asarray(np.bincount(label, f[used], count), dtype=np.float64)

        A11, A12, A22 = (total(g[i] * g[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        s1, s2 = total(g[0] * r), total(g[1] * r)
        ridge = 1e-6 * float((A11 + A22).mean())
        A11, A22 = A11 + ridge, A22 + ridge
        det = A11 * A22 - A12**2
        loss: Array = (A22 * s1**2 - 2 * A12 * s1 * s2 + A11 * s2**2) / (det * self.match.noise**2)
        return loss

    def smooth(self, estimate: Estimate, backgrounds: Sequence[Array]) -> list[Array]:
        """Displacements as the preset estimates them, about one for each part, true lengths."""
        F = estimate.functional
        ridge = RIDGE * self.match.strength * np.reshape([1, 0, 1], (3, 1, 1))
        fields = []
        for out, u_bg in zip(self.masks, backgrounds, strict=True):
            terms = self.match.eased(estimate.ease).density(u_bg, ~out)
            F = Quadratic(
                F.grid, Pointwise(terms.A + ridge, terms.b), F.alpha, F.free, F.smoothness
            )
            fields.append(u_bg + multigrid(F, change=ACCURACY))
        return fields
