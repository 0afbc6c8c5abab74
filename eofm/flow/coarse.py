"""What is decided on a coarse grid: from which field to go on, and what to leave out."""

from collections.abc import Sequence
from dataclasses import replace

from eofm.flow.elsewhere import Elsewhere, elsewhere
from eofm.flow.images import COARSE, FINEST, resized
from eofm.flow.likeness import alike, correlation, unlike
from eofm.flow.pair import ImagePair
from eofm.flow.problem import Problem
from eofm.flow.pyramid import largest_small
from eofm.flow.start import match_blocks
from eofm.flow.trial import around
from eofm.grid import Array, Mask
from eofm.imaging.intensity import normalise_locally

# Part of the first weight with which coarse scales follow motions that turn within some of their
# samples, and what they then leave at most of how far the images are from correlating.
SOFT, FOLLOWED = 0.01, 0.75
# Least correlation after a start of images of two scales, whose few blocks may match by chance.
LIKELY = 0.5
# How often what the images do not share is looked for, and how far from dead pixels, samples.
TURNS, BESIDE = 3, 6


def misses(problem: Problem, number: int, pairs: Sequence[ImagePair], u: Array) -> bool:
    """Whether softer grids, up to one, leave clearly less unlike than a field there.

    Small weights follow noise, where a large one does not follow a motion that turns within some
    samples.
    """
    softer, soft = replace(problem, part=SOFT), problem.u_bg
    for coarser in range(number + 1):
        soft = softer.level(coarser, pairs[coarser], soft).improve((), False).u
    pair = pairs[number]
    missed, left = (1 - correlation(pair.I1, pair.I2, v, pair.grid) for v in (u, soft))
    return left < FOLLOWED * missed


def best_start(problem: Problem, number: int, pairs: Sequence[ImagePair], u: Array) -> Array:
    """That of ``u``, on a grid, and the field of matched blocks after which images correlate best.

    Blocks are matched on a grid that is fine enough for many of them.
    """
    # Of a volume in tiles, the finest scales are not there.
    pair, fine = pairs[number], pairs[min(largest_small(problem.grids), len(pairs) - 1)]
    I1, I2 = (normalise_locally(I, (COARSE,) * I.ndim) - 0.5 for I in (fine.I1, fine.I2))
    matched = match_blocks(I1, I2, fine.grid)
    if matched is None:
        return u
    other = problem.level(number, pair, matched).improve((), False).u
    before, after = (correlation(pair.I1, pair.I2, v, pair.grid) for v in (u, other))
    likely = len(problem.grids) > FINEST or after >= LIKELY
    return other if after > before and likely else u


def look_again(problem: Problem, pair: ImagePair, live: Mask, u: Array) -> ImagePair:
    """Take back what a coarser grid has left out of the pixels that are ``live``, where it matches.

    What the images do not share looks larger there, by some of its samples on each side.
    """
    doubted = live & ~pair.live
    if not doubted.any():
        return pair
    u = problem.carried(u, pair.grid.shape)
    return replace(pair, live=pair.live | (doubted & alike(pair.I1, pair.I2, u, pair.grid, live)))


def leave_out(
    problem: Problem, number: int, pairs: list[ImagePair], u: Array
) -> tuple[Array, list[Elsewhere]]:
    """Mark what the images do not share as dead on this grid and on finer ones; the field without.

    The field that it has pulled hides a part of it, so it is looked for again. Near pixels that
    are dead, coarse images are not what they seem. What both images show, in other places, is left
    out as well, for a smooth field follows one motion, and returned.
    """
    moved = list[Elsewhere]()
    whole = ~around(~(pairs[number].live & pairs[number].live_after), BESIDE)
    for _ in range(TURNS):
        pair = pairs[number]
        found = unlike(pair.I1, pair.I2, u, pair.grid, pair.live & whole)
        if found is None:
            break
        fine = pairs[-1]
        samples = fine.grid.samples(problem.carried(u, fine.grid.shape))
        doubted = resized(found, fine.grid.shape) & fine.live
        moved.append(elsewhere(fine.I1, fine.I2, samples, doubted))
        for finer in range(number, len(pairs)):
            live = pairs[finer].live & ~resized(found, pairs[finer].grid.shape)
            pairs[finer] = replace(pairs[finer], live=live)
        u = problem.level(number, pairs[number], u).improve((), False).u
        u = best_start(problem, number, pairs, u)
    return u, moved
