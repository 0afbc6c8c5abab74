"""Motion of edges: as it is stated, which images may contradict, or sought about an estimate."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from eofm.elasticity.forward import deform
from eofm.elasticity.sensitivity import Elastic
from eofm.errors import UndeterminedError
from eofm.flow.estimate import estimate_displacement
from eofm.flow.found import Estimate
from eofm.flow.known import Known
from eofm.grid import FACES, Array, Edge
from eofm.settings import Estimation, Identification, Sample

# Contradictions smaller than this are none, px.
UNCERTAIN = 0.5
# Standard deviations by which a contradiction has to stand out, and samples that tell them.
CLEAR, SCALE_SAMPLES = 3.0, 16
# Distance of the nodes between which an edge moves linearly, px.
HATS = 7.0
# What the motion of an edge may be off by: some deviations of the estimate, and px.
DOUBT, UNKNOWN = 2.0, 0.02
SAMPLES = 8
# Distance over which what it is off by is alike, px: what an estimate gets wrong is smooth.
ALIKE = 14.0
# Modes with a smaller part of the variance of the largest are left out.
LEAST = 1e-3


def motions(model: Elastic, estimate: Estimate, h: Array) -> sp.csc_array:
    """Motions of the loose edges, one standard deviation each.

    Modes of a normal field along them whose covariance is ``d(x) d(y) (1 + r) exp(-r)``, with
    the doubt d of each place and ``r = sqrt(3) |x - y| / ALIKE`` (Matern's, of fields that have
    a slope). Edges whose places are free of each other would follow the noise of single bubbles,
    and the modulus with them.

    Parameters
    ----------
    model : Elastic
    estimate : Estimate
        Whose motion is the first guess.
    h : ndarray, shape (2, 1, 1)
        Sides of a pixel.

    Returns
    -------
    sparse matrix, shape (degrees of freedom, modes)
    """
    hats, nodes = model.hats(HATS)
    if not model.loose:
        return hats
    sides = zip(nodes, model.sample.shape, model.shape, strict=True)
    x2, x1 = (k * (n - 1) / e for k, n, e in sides)
    doubt = h * (DOUBT * estimate.deviation(SAMPLES) + UNKNOWN)
    i, j = np.round(x2).astype(int), np.round(x1).astype(int)
    x = h[:, 0] * np.stack([x1, x2])
    r = np.sqrt(3 * ((x[:, :, None] - x[:, None]) ** 2).sum(0)) / ALIKE
    variance, modes = np.linalg.eigh((1 + r) * np.exp(-r))
    kept = variance > LEAST * variance[-1]
    root = modes[:, kept] * np.sqrt(variance[kept])
    block = sp.block_diag([d[:, None] * root for d in doubt[:, i, j]])
    return (hats @ block).tocsc()


def moved(
    I1: Array,
    I2: Array,
    sample: Sample,
    settings: Identification,
    estimation: Estimation,
    known: Known,
    motion: dict[Edge, Array],
) -> tuple[float, dict[Edge, Array], Array]:
    """Factor of the edges' motion, that motion, and the homogeneous background."""
    u_bg = deform(sample, motion, pixel_size=known.sides(2))
    blind = estimation.changed(zero_edges=())
    free = estimate_displacement(I1, I2, blind, replace(known, background=u_bg, edges={}))
    scale = factor_of_motion(free, u_bg, motion, settings)
    return scale, {edge: scale * g for edge, g in motion.items()}, scale * u_bg


def factor_of_motion(
    free: Estimate, u_bg: Array, edges: Iterable[Edge], settings: Identification
) -> float:
    """Factor of the edges' motion for which the images ask, 1 where they may mean that.

    ``free`` does not know the edges. The factor is the least squares fit of the medians along
    them, less their mean, to those of the stated motion. It differs from 1 by more than
    ``settings.trust``, and clearly more than errors of ``free`` as they may be would make it.

    Raises
    ------
    UndeterminedError
        If the images contradict the motion of an edge by more than ``settings.doubt``, or the
        edges move alike over most of their length.
    """

    def medians(v: Array) -> Array:
        return np.array([np.median(v[:, *FACES[edge].pixels()], axis=1) for edge in edges])

    seen, stated = medians(free.u), medians(u_bg)
    a, b = seen - seen.mean(0), stated - stated.mean(0)
    largest = float(np.abs(stated).max())
    if np.abs(b).max() <= 0.01 * largest:
        raise UndeterminedError(
            "stiffness cannot be told from edges most of which move alike; it needs two that move"
            " differently over most of their length"
        )
    scale = float((a * b).sum() / (b * b).sum())
    wrong = float(np.abs(seen - stated).max())
    if wrong > max(settings.doubt * largest, UNCERTAIN) or abs(scale - 1) > settings.doubt:
        raise UndeterminedError(
            f"the images contradict the motion of the edges by {wrong:.2f} px and would have"
            f" {scale:.3f} times of it; state it better, or raise the doubt ({settings.doubt:g})"
        )
    if abs(scale - 1) <= settings.trust:
        return 1.0
    errors = (medians(error) for error in free.samples(SCALE_SAMPLES))
    chance = [(error * b).sum() / (b * b).sum() for error in errors]
    return 1.0 if abs(scale - 1) <= CLEAR * np.sqrt(np.mean(np.square(chance))) else scale


def move_differently(motion: Mapping[Edge, Array]) -> bool:
    """Whether two edges at least are known to move, and not alike."""
    means = np.array([np.nan_to_num(g.mean(1)) for g in motion.values()])
    return len(means) >= 2 and bool(np.ptp(means, axis=0).any())
