"""What the images say of the motion of edges that was stated."""

import math
from collections.abc import Mapping

import numpy as np

from eofm.flow.functional import Pointwise, Quadratic, unit
from eofm.flow.matching import Match
from eofm.flow.multigrid import multigrid
from eofm.flow.trial import RIDGE, reach
from eofm.grid import FACES, Array, Edge, Grid, Mask, along_face, faces

# Least samples beside an edge on which the images are compared.
LEAST = 4
# Differences of motion that are none, px.
NONE = 0.1
# How much more has to be left of the images than noise that is followed, and which difference tells
# by itself: px, and times that which the images leave open.
MORE, FAR, OPEN = 4.5, 0.5, 2.0
# Change of the field by the last iteration, px.
ACCURACY = 1e-2
TINY = float(np.finfo(np.float32).tiny)


def on_edges(grid: Grid, profiles: Mapping[Edge, Array]) -> dict[Edge, Array]:
    """Profiles along edges sampled on a grid, in the order in which they own corners."""
    sampled = {}
    for edge, face in faces(grid.ndim).items():
        if edge in profiles:
            parts = (np.linspace(0, 1, n) for n in face.sides(grid.shape))
            sampled[edge] = along_face(profiles[edge], *parts)
    return sampled


def contradictions(
    match: Match, F: Quadratic, base: Array, v: Array, stated: Mapping[Edge, Mask], spread: float
) -> dict[Edge, float]:
    """By how much the images contradict the motion of edges, px, of those that they do.

    The field is sought once more with all edges free. Where the stated motion is right, that one
    follows the noise beside an edge, and so leaves less of the images, by about the noise of
    ``ndim`` numbers for each patch as large as the weight smooths over; where it is wrong, by more.
    Along an edge that slides the difference may be zero in the mean, so its root mean square
    counts. An edge that is wrong by pixels shows in the difference alone, for there the images are
    linearised about a field that is far off.

    Parameters
    ----------
    match : Match
        The images linearised about the estimate, eased as in F.
    F : Quadratic
        That was minimised last.
    base, v : ndarray, shape (ndim, ...)
        The estimate is ``base + v``, and R acts on ``v``.
    stated : mapping of ndarray of bool, shape (ndim, n, ...)
        For each edge, components and pixels whose motion was stated.
    spread : float
        About how far the images leave the motion open, px.
    """
    grid, off = match.grid, dict[Edge, float]()
    if not stated or not match.strength:
        return off
    terms = match.density(base)
    # Without edges, images of which a part is live may leave a motion undetermined.
    terms = Pointwise(terms.A + RIDGE * match.strength * unit(terms.b), terms.b)
    everywhere = np.ones(grid.shape, dtype=bool)
    free = Quadratic(grid, terms, F.alpha, everywhere, F.smoothness)
    other = multigrid(free, change=ACCURACY, initial=v)
    left = match.residual(base + other) ** 2 * match.used
    gained = match.residual(base + v) ** 2 * match.used - left
    # A field that cannot but be affine follows as much as in two patches along each axis.
    patch = min(max(reach(match, F.alpha, F.smoothness), LEAST), min(grid.shape) / 2)
    rows, followed = round(patch), grid.ndim / patch**grid.ndim
    difference = grid.samples(other - v)
    for edge, where in stated.items():
        face = FACES[edge]
        d = difference[:, *face.pixels(grid.ndim)][where]
        rms = math.sqrt(np.mean(d**2)) if d.size else 0.0
        part = [slice(None)] * grid.ndim
        part[face.axis(grid.ndim)] = slice(-rows, None) if face.last else slice(rows)
        beside = tuple(part)
        more = gained[beside].sum() / (followed * left[beside].sum() + TINY)
        if rms > max(FAR, OPEN * spread) or (rms > NONE and more > MORE):
            off[edge] = rms
    return off
