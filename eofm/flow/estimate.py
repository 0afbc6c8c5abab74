"""The elastographic optical flow method: all five tests of the paper, and your images."""

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from eofm.errors import InputError
from eofm.flow.coarse import SOFT, best_start, leave_out, look_again, misses
from eofm.flow.detector import without_lines
from eofm.flow.elsewhere import Elsewhere
from eofm.flow.found import Estimate
from eofm.flow.images import COARSE, FINEST, Images
from eofm.flow.known import NO_DATA, Known
from eofm.flow.labels import labels
from eofm.flow.likeness import details, ratio_left
from eofm.flow.pair import ImagePair
from eofm.flow.problem import Improved, Level, Problem
from eofm.flow.pyramid import largest_small
from eofm.grid import Array, Mask, componentwise
from eofm.imaging.intensity import normalise, real
from eofm.imaging.printed import frames
from eofm.imaging.splines import resize_field
from eofm.settings import Estimation

# Change of brightness, as a part of the contrast, that may be taken for motion. Images are then
# normalised locally where that leaves fewer of the details unlike: by this factor, and difference.
SHADED, LESS, CLEARLY = 0.05, 0.98, 1e-3
# Change of brightness up to which there may be none, what a field then leaves of the images'
# contrast at most if another one may leave less, and what that leaves of it at most.
STEADY, QUIET, BETTER = 0.02, 0.12, 0.95
# What a field from another start leaves of the variance of the images' difference, at most.
CLEARER = 0.94
log = logging.getLogger(__name__)


def estimate_displacement(
    I1: Array,
    I2: Array,
    settings: Estimation = Estimation(),
    known: Known = Known(),
    *,
    progress: bool = False,
) -> Estimate:
    """Displacement between two images by elastographic optical flow.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width) or (depth, height, width)
        Images, or volumes, before and after compression.
    settings : Estimation
        Weights, scales and edges. The defaults are the preset, the most accurate way this
        package has; ``Estimation(method="paper")`` is the paper's.
    known : Known
        Bubbles, background, edges, dead zones and the size of the pixels.
    progress : bool
        Show a progress bar, if standard error is a terminal.

    Returns
    -------
    Estimate
        Its ``u`` is the displacement, px, shape (2, height, width) or (3, depth, height,
        width); of volumes in single precision.

    Raises
    ------
    InputError
        If the images are constant, too small for the scales, or no numbers, or what is known
        does not fit them.

    Notes
    -----
    On each scale, ``v`` minimises F, eq. (def_F), with I2 linearised about the current
    field ``u0`` (zero or u_bg to start with) by ``I_t = I2(x + u0) - I1 - g . u0``. With one
    scale, one warp, zero to start with and ``g = grad I1`` this is the paper's problem,
    ``I_t = I2 - I1``. Pixels that leave the image, ``x + u0(x)`` outside of it, carry no
    data.

    The paper leaves open how several scales go together; ``settings`` holds what can be read
    into it. With ``method="paper"``, ``u0 = 0`` on all of them, the field of each scale is the
    u_bg of the next, and half of the resolution is the last. That reading is the nearest to
    the paper's table, and it cannot follow motions that are larger than the speckle.

    Examples
    --------
    >>> import numpy as np
    >>> import eofm
    >>> u = np.zeros((2, 40, 60))
    >>> u[0] = 0.5
    >>> before, after, bubbles = eofm.make_phantom(u, eofm.Phantom(seed=2))
    >>> found = eofm.estimate_displacement(before, after)
    >>> found.u.shape
    (2, 40, 60)
    >>> bool(abs(found.u - u).max() < 0.05)
    True
    """
    I1, I2 = real(I1), real(I2)
    known.check(I1, I2)
    if not settings.robust:
        return _estimate(I1, I2, settings, known, progress)
    dead = known.dead_on(I1.shape)
    frame = frames(*normalise(I1, I2), dead)
    dead = dead | frame
    if known.dead is not None and dead.all():
        raise InputError(NO_DATA)
    known = replace(known, dead=dead) if frame.any() else known
    estimate = partial(_estimate, settings=settings, known=known, progress=progress)
    found = without_lines(I1, I2, dead, estimate)
    return replace(found, printed=found.printed | frame)


def _estimate(I1: Array, I2: Array, settings: Estimation, known: Known, progress: bool) -> Estimate:
    """The estimate, as the images ask for it.

    Where motion turns within some samples of coarse scales, these are softer if less of the images
    is left then. Of images that oscillate, it starts from their amplitude's motion, likewise; and
    they are normalised locally where that leaves more of them alike.
    """
    left_out = np.zeros(I1.shape, dtype=bool)
    if settings.robust and I1.ndim == 2:
        left_out = labels(I1, I2, settings, known)
        known = replace(known, dead=left_out | known.dead_on(I1.shape))
    images = Images.of(I1, I2, settings, known)
    run = partial(_coarse_to_fine, known=known, left_out=left_out, progress=progress)
    found, shaded, turns = run(images, settings)

    def clearer(way: Callable[..., Run]) -> Run | None:
        """What another way finds, if it is clearly better."""
        other = way(images, settings)
        # Where a field is off by a period, its images have been said to show different things.
        left = ratio_left(I1, I2, known.dead_on(I1.shape), found.u, other.found.u)
        return other if left < CLEARER else None

    if turns and (better := clearer(soft := partial(run, part=SOFT))):
        log.debug("motion turns within some samples of coarse scales: they were softer")
        (found, shaded, _), run = better, soft
    if settings.robust and images.oscillate:
        by_amplitude = run(images.amplitudes, settings).found
        if better := clearer(start := partial(run, start=by_amplitude.lengths)):
            log.debug("the images oscillate: their amplitude's motion is the better start")
            (found, shaded, _), run = better, start
    if settings.robust and settings.denoising is None and settings.local_window is None:
        found = without_standing(found, lambda way: run(images, settings.changed(**way)).found)
    if not shaded:
        return found
    local = run(images, settings.changed(local_window=COARSE)).found
    pair = found.pair
    missed, less = (
        1 - details(pair.I1, pair.I2, f.lengths, pair.grid, pair.live) for f in (found, local)
    )
    if less > LESS * missed or missed - less < CLEARLY:
        return found
    log.debug("brightness changes within structures of the image: it was normalised locally")
    return local


def without_standing(found: Estimate, estimate: Callable[[dict[str, float]], Estimate]) -> Estimate:
    """The estimate, or one without structures that stand while the sample moves, if less pulls."""
    # A field that follows noise, of which some structures have less, is pulled by that.
    if not (way := found.standing.way_out) or found.standing.pull < found.spread:
        return found
    other = estimate(way)
    if not other.standing.pulls_less(found.standing):
        return found
    log.debug("something stands still while the sample moves; estimated with %s", way)
    return other


class Run(NamedTuple):
    """The estimate of one way through the scales, and what speaks for another one.

    ``shaded`` where brightness changes so much that it may have been taken for motion; ``turns``
    where motion may turn within some samples of the coarse scales, which then lose it.
    """

    found: Estimate
    shaded: bool
    turns: bool


def _coarse_to_fine(
    images: Images,
    settings: Estimation,
    known: Known,
    left_out: Mask,
    progress: bool,
    start: Array | None = None,
    part: float = 1.0,
) -> Run:
    """The estimate with a ``part`` of the first weight on coarse scales.

    From a ``start``, in true lengths, the finest scales alone are gone through. What changes within
    structures is not told from motion by the brightness that is fitted on these.
    """
    shape = images.I1.shape
    ndim = len(shape)
    problem = replace(Problem.of(shape, settings, known), part=part)
    pairs = images.pairs(problem.grids, settings, known)
    decides = settings.robust and settings.local_window is None
    first, u = (0, problem.u_bg) if start is None else (max(0, len(pairs) - FINEST), start)
    chosen, turns, moved = tuple[float, ...](), False, list[Elsewhere]()
    hidden = None if progress else True
    # Of small images, it is the coarser one of two.
    compared = min(largest_small(problem.grids), max(len(pairs) - 1 - FINEST, 0))
    all_live = [pair.live for pair in pairs]
    for number in tqdm(range(first, len(pairs)), "scales", disable=hidden):
        pair = pairs[number] = look_again(problem, pairs[number], all_live[number], u)
        level = problem.level(number, pair, u)
        u, alpha, F, chosen, factor = level.improve(chosen, progress)
        if settings.robust and number == compared < len(pairs) - 1:
            turns = settings.alpha is None and part == 1 and misses(problem, number, pairs, u)
            u = best_start(problem, number, pairs, u)
            u, moved = leave_out(problem, number, pairs, u) if ndim == 2 else (u, moved)
    shading = 0.0
    if decides:
        coarser = pairs[max(0, len(pairs) - FINEST)]
        shading = coarser.shading(resize_field(u, coarser.grid.shape))
        # Of a volume, that would be half of the work once more.
        if ndim == 2 and shading < STEADY and (better := steady(level, u, alpha, factor)):
            pair, (u, alpha, F, _, factor) = better
    # What was found elsewhere may have been reached by finer grids.
    astray = max((seen.astray(pair.grid.samples(u)) for seen in moved), default=0.0)
    spacing = known.spacing(ndim)
    u = problem.carried(u, shape) / componentwise(spacing, ndim)
    # Of volumes, that what did not match at first is taken back alone.
    unlike = float((all_live[-1] & ~pair.live).mean()) if ndim == 2 else 0.0
    found = Estimate(
        u,
        alpha,
        pair,
        settings.denoising,
        F,
        level.base,
        factor,
        left_out,
        spacing,
        level.stated,
        unlike=unlike,
        astray=astray,
    )
    return Run(found, shading > SHADED, turns)


def steady(
    level: Level, u: Array, alpha: float, ease: Array | None
) -> tuple[ImagePair, Improved] | None:
    """A field for images of one gain and one offset, and the images so, if it is clearly better.

    What is left of the motion of large structures looks like a change of brightness, and one that
    is fitted locally takes it away. Even so it is that fit which has to leave less of the
    images: it favours the field that was found with it. Where most of what is left is noise, no
    field leaves less.
    """
    before = level.pair.linearise(u)
    if before.noise > QUIET * level.pair.I1.std():
        return None
    pair = replace(level.pair, even=True)
    even = replace(level, pair=pair, coarse=u, decides=False, ease=ease)
    found = even.improve((alpha,), False)
    after = level.pair.linearise(found.u)
    return (pair, found) if after.noise < BETTER * before.noise else None
