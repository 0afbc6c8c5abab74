"""Labels that are printed on both images: what stays where the sample moves."""

from dataclasses import replace

import numpy as np

from eofm.flow.images import Images, resized
from eofm.flow.known import Known
from eofm.flow.pair import ImagePair
from eofm.flow.problem import Problem
from eofm.flow.pyramid import largest_small
from eofm.grid import Array, Mask
from eofm.imaging.defects import filled
from eofm.imaging.gaussian import blur
from eofm.imaging.intensity import normalise
from eofm.imaging.printed import suspects
from eofm.imaging.splines import Spline
from eofm.settings import Estimation

# Part of the squared difference that standing still leaves of that which a motion leaves, where
# something stays; and the motion of that which standing still leaves, in the rest around, of whose
# pixels no more than so much comes from what is doubted; and the least motion, samples.
STAYS, MOVES, CLEAN, FAR = 0.25, 0.5, 0.05, 0.2
# Widths over which differences are averaged, there and in the rest around, samples.
WIDTH, WIDE = 3.0, 8.0


def labels(I1: Array, I2: Array, settings: Estimation, known: Known) -> Mask:
    """Labels of images.

    What may be one is left out first. It is one where the motion that the others show is not its
    own, but standing still is.
    """
    dead = known.dead_on(I1.shape)
    J1, J2 = (filled(J, dead) for J in normalise(I1, I2))
    doubted = suspects(J1, J2) & ~dead
    if not doubted.any():
        return doubted
    problem = Problem.of(I1.shape, settings, known)
    grids = problem.grids[: largest_small(problem.grids) + 1]

    def pairs(dead: Mask) -> list[ImagePair]:
        apart = replace(known, dead=dead)
        return Images.of(I1, I2, settings, apart).pairs(grids, settings, apart)

    u = problem.u_bg
    for number, pair in enumerate(pairs(dead | doubted)):
        u = problem.level(number, pair, u).improve((), False).u
    whole, small = pairs(dead)[-1], resized(doubted, grids[-1].shape)
    still = standing(whole, u, small)
    return doubted & resized(still, doubted.shape)


def standing(pair: ImagePair, u: Array, doubted: Mask) -> Mask:
    """Where some parts stay as they are, though a displacement carries the rest of the image.

    None where the displacement is hardly one.
    """
    from scipy import ndimage

    samples = pair.grid.samples(u)
    warped, seen = Spline(pair.I2).warp(samples)
    moved, stayed = ((J - pair.I1) ** 2 for J in (warped, pair.I2))
    out = (doubted | ~pair.live).astype(pair.I2.dtype)
    rest = seen & (out == 0) & (Spline(out).warp(samples)[0] < CLEAN)

    def around(mask: Mask, width: float) -> tuple[Array, ...]:
        return tuple(blur(np.where(mask, f, 0), width) for f in (moved, stayed))

    (moved_there, stayed_there), (moved_by, stayed_by) = around(doubted, WIDTH), around(rest, WIDE)
    still = doubted & seen & (np.hypot(*samples) > FAR)
    still &= (stayed_there < STAYS * moved_there) & (moved_by < MOVES * stayed_by)
    # Parts most of which stay do so as a whole.
    label, count = ndimage.label(doubted, np.ones((3,) * doubted.ndim))
    stays, size = (np.bincount(label[at], minlength=count + 1) for at in (still, doubted))
    found: Mask = still | (2 * stays > size)[label]
    return found
