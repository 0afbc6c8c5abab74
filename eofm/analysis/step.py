"""One step from a frame to the next: what was found, and whether the images bear it out."""

import logging
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from eofm.analysis.quality import inconsistency
from eofm.analysis.summary import length
from eofm.errors import UndeterminedError
from eofm.flow.estimate import estimate_displacement
from eofm.flow.found import Estimate
from eofm.flow.known import Known
from eofm.flow.trust import Trust, Verdict
from eofm.grid import Array, Mask
from eofm.identification.stiffness import Stiffness, identify_stiffness
from eofm.identification.uncertainty import deviations
from eofm.imaging.bubbles import followed
from eofm.settings import WARPING, Estimation, Identification, Sample, Tracking

log = logging.getLogger(__name__)

# Correlation of the images above which bubbles that move otherwise by so many px are left out.
SURE, CONTRADICTING = 0.5, 1.5
# Median error bar, and median forward-backward error, that raise doubts, px.
LONG = 0.25


@dataclass(frozen=True)
class Step:
    """Results of one step from a frame to the next, px.

    Attributes
    ----------
    estimate : Estimate
    deviation : ndarray, shape (2, height, width), or None
        Standard deviation of its displacement.
    standard : ndarray, shape (2, height, width), or None
        Standard optical flow of images, for comparison; it is not computed of volumes.
    bubbles : DataFrame
        Those that were followed.
    found : int
        Bubbles in the first of its frames.
    inconsistency : ndarray, shape (height, width)
        Forward-backward error.
    trust : Trust
        Whether the images bear the estimate out.
    stiffness : Stiffness or None
    refused : str
        Why there is no modulus that may be trusted, where one was asked for.
    modulus_deviation : ndarray, shape (height, width), or None
        Standard deviation of the logarithm of its modulus.
    """

    estimate: Estimate
    deviation: Array | None
    standard: Array | None
    bubbles: pd.DataFrame
    found: int
    inconsistency: Array
    trust: Trust
    stiffness: Stiffness | None
    refused: str
    modulus_deviation: Array | None


def follow(
    I1: Array,
    I2: Array,
    known: Known,
    tracking: Tracking,
    estimation: Estimation,
    sought: tuple[Sample, Identification] | None,
    error_bars: int,
    progress: bool,
) -> Step:
    """Standard flow, tracked bubbles, EOFM or the identified sample, and EOFM backwards."""
    kept = estimation.model_dump(include={"scales", "factor", "limits", "local_window"})
    plain = Estimation(method="paper", beta=0.0, warps=estimation.warps, **WARPING, **kept)
    alone = Known(dead=known.dead, pixel_size=known.pixel_size)
    standard = None
    if I1.ndim == 2:
        standard = estimate_displacement(I1, I2, plain, alone, progress=progress).u
    # Bubbles are sought where the images alone, followed as well as can be, say that they went.
    images = estimate_displacement(I1, I2, Estimation(**kept), known, progress=progress)
    bubbles, found = _tracked(I1, I2, tracking, images, known.dead)
    known = replace(known, bubbles=bubbles)
    stiffness, deviation, modulus_deviation, refused = None, None, None, ""
    if sought is not None:
        try:
            stiffness = identify_stiffness(I1, I2, *sought, estimation, known, progress=progress)
        except UndeterminedError as error:
            refused = str(error)
    if stiffness is None:
        estimate = estimate_displacement(I1, I2, estimation, known, progress=progress)
        if error_bars:
            deviation = estimate.deviation(error_bars)
    else:
        estimate, refused = stiffness.estimate, stiffness.refused
        if error_bars:
            deviation, modulus_deviation = deviations(stiffness, samples=error_bars)
        # What the way there has learnt, the way back knows too.
        edges = {edge: stiffness.scale * g for edge, g in known.edges.items()}
        u_bg = known.background if stiffness.alone else stiffness.elastic
        known = replace(known, background=u_bg, edges=edges)
    if refused:
        log.warning("no stiffness: %s", refused)
    back = known.backwards(I2.shape)
    again = estimation.changed(alpha=estimate.alpha)
    w = estimate_displacement(I2, I1, again, back, progress=progress).u
    errors = inconsistency(estimate.u, w)
    return Step(
        estimate,
        deviation,
        standard,
        bubbles,
        found,
        errors,
        _trust(estimate.trust, deviation, errors, known.dead),
        stiffness,
        refused,
        modulus_deviation,
    )


def _tracked(
    I1: Array, I2: Array, tracking: Tracking, images: Estimate, dead: Mask | None
) -> tuple[pd.DataFrame, int]:
    """Bubbles outside of dead zones that do not contradict what the images say where they agree.

    And how many there are in the first image. None may be left, as of images with much noise: the
    field then rests on the images alone.
    """
    bubbles = followed(I1, I2, tracking, images.u)
    found = int(bubbles.attrs["found"])
    x, motion = (
        bubbles[[f"{name}{i + 1}" for i in range(I1.ndim)]].to_numpy().T for name in ("x", "u")
    )
    at = tuple(x[::-1].round().astype(np.intp))
    live = np.ones(len(bubbles), dtype=bool) if dead is None else ~dead[at]
    off = length(motion - images.u[:, *at])
    sure = np.nan_to_num(images.trust.map)[at] > SURE
    kept = live & (~sure | (off <= CONTRADICTING))
    return bubbles[kept if kept.any() else live].reset_index(drop=True), found


def _trust(trust: Trust, deviation: Array | None, errors: Array, dead: Mask | None) -> Trust:
    """The verdict, and what error bars and the way back add to it."""
    live = np.ones(errors.shape, dtype=bool) if dead is None else ~dead
    bar = None if deviation is None else float(np.median(length(deviation)[live]))
    told = errors[live & np.isfinite(errors)]
    return doubted(trust, bar, float(np.median(told)) if told.size else None)


def doubted(trust: Trust, bar: float | None, gap: float | None = None) -> Trust:
    """The verdict, and what the medians of error bars and of the way back, px, add to it."""
    doubts = []
    if bar is not None and bar > LONG:
        doubts.append(f"half of the error bars are longer than {bar:.2f} px")
    if gap is not None and gap > LONG:
        doubts.append(f"the way back misses the start by {gap:.2f} px in the median")
    if not doubts:
        return trust
    verdict: Verdict = "failed" if trust.verdict == "failed" else "doubtful"
    return replace(trust, verdict=verdict, reasons=(*trust.reasons, *doubts))
