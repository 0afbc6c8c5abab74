"""Your own images: all results of a pair or a sequence."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eofm.analysis.quality import data_share, inconsistency, residual
from eofm.analysis.scene import Scene, prepare
from eofm.analysis.strain import FILTER, strain
from eofm.errors import InputError
from eofm.flow.estimate import Estimate, estimate_displacement, normalised
from eofm.grid import FACES, Array, inside, unit_spacing
from eofm.identification.stiffness import Stiffness, identify_stiffness
from eofm.identification.uncertainty import deviations
from eofm.imaging.bubbles import track
from eofm.imaging.splines import warp_field
from eofm.settings import Estimation, Identification, Pair, Tracking


@dataclass(frozen=True)
class Step:
    """Results of one step from a frame to the next, px.

    Attributes
    ----------
    estimate : Estimate
    deviation : ndarray, shape (2, height, width), or None
        Standard deviation of its displacement.
    standard : ndarray, shape (2, height, width)
        Standard optical flow, for comparison.
    bubbles : DataFrame
    inconsistency : ndarray, shape (height, width)
        Forward-backward error.
    stiffness : Stiffness or None
    modulus_deviation : ndarray, shape (height, width), or None
        Standard deviation of the logarithm of its modulus.
    """

    estimate: Estimate
    deviation: Array | None
    standard: Array
    bubbles: pd.DataFrame
    inconsistency: Array
    stiffness: Stiffness | None
    modulus_deviation: Array | None


@dataclass(frozen=True)
class Analysis:
    """Results of a pair or a sequence.

    Attributes
    ----------
    first, last : ndarray, shape (height, width)
        First and last frame in the region of interest.
    u : ndarray, shape (2, height, width)
        Displacement from the first frame to the last, px.
    deviation : ndarray, shape (2, height, width), or None
        Its standard deviation, px; errors of steps count as independent.
    steps : list of Step
        The results of each step.
    strain : ndarray, shape (3, height, width)
        Lateral, axial and shear strain of ``u``.
    residual, share : ndarray, shape (height, width)
        Difference of the warped last frame from the first; share of the data.
    summary : dict
        What a reader wants to know first.
    """

    first: Array
    last: Array
    u: Array
    deviation: Array | None
    steps: list[Step]
    strain: Array
    residual: Array
    share: Array
    summary: dict[str, Any]


def analyse(
    pair: Pair,
    tracking: Tracking = Tracking(),
    estimation: Estimation = Estimation(),
    identification: Identification = Identification(),
    *,
    progress: bool = False,
) -> Analysis:
    """Displacement, strain and their quality for a pair or sequence of images.

    Parameters
    ----------
    pair : Pair
        The images and what is known of the sample.
    tracking, estimation, identification : Tracking, Estimation, Identification
        Settings of the steps.
    progress : bool
        Show progress bars, if standard error is a terminal.

    Raises
    ------
    InputError
        If anything described cannot be used.

    Notes
    -----
    In a sequence, the motion of an edge is that of one step, and each step imposes it on
    the image's own rows and columns: right while the edge stays near them. The modulus
    is that of the first step, when the sample is where the image shows it.
    """
    scene = prepare(pair)
    steps: list[Step] = []
    total, variance = np.zeros((2, *scene.dead.shape)), np.zeros((2, *scene.dead.shape))
    for I1, I2 in zip(scene.frames[:-1], scene.frames[1:], strict=True):
        sought = identification if pair.stiffness and not steps else None
        step = _step(I1, I2, scene, pair, tracking, estimation, sought, progress)
        steps.append(step)
        # What was at x is at x + total(x) now, and moves on from there.
        if step.deviation is not None:
            variance += np.maximum(warp_field(step.deviation**2, total), 0)
        total = total + warp_field(step.estimate.u, total)
        for edge in scene.edges if estimation.edge_weight is None else ():
            total[:, *FACES[edge].pixels()] = sum(
                s.estimate.u[:, *FACES[edge].pixels()] for s in steps
            )
    spacing = unit_spacing(pair.pixel_size)
    window = pair.strain_window or 3 * float(np.sqrt(np.prod(pair.pixel_size)))
    first, last = scene.frames[0], scene.frames[-1]
    e = strain(total, pair.pixel_size, window)
    left = residual(first, last, total)
    share = data_share(
        normalised(first, last, estimation, spacing)[0],
        estimation.smoothness,
        steps[-1].estimate.alpha,
        estimation.sigma,
        spacing,
        scene.dead,
    )
    summary = _summary(pair, scene, steps, total, e, window)
    summary |= {
        "residual_rms": float(np.sqrt(np.nanmean(left[~scene.dead] ** 2))),
        "residual_rms_without_motion": float(
            np.sqrt(np.nanmean(residual(first, last, 0 * total)[~scene.dead] ** 2))
        ),
        "share_of_data_median": float(np.median(share)),
    }
    if (found := steps[0].stiffness) is not None:
        summary["stiffness"] = {
            "modulus_range": [float(found.E.min()), float(found.E.max())],
            "edge_motion_factor": found.scale,
            "gamma": found.gamma,
            "rounds": found.rounds,
            "last_change_of_u": found.change,
        }
    deviation = np.sqrt(variance) if pair.error_bars else None
    if deviation is not None:
        summary["deviation_median_px"] = [float(np.median(d)) for d in deviation]
    return Analysis(first, last, total, deviation, steps, e, left, share, summary)


def _step(
    I1: Array,
    I2: Array,
    scene: Scene,
    pair: Pair,
    tracking: Tracking,
    estimation: Estimation,
    identification: Identification | None,
    progress: bool,
) -> Step:
    """Standard flow, tracked bubbles, EOFM or the identified sample, and EOFM backwards."""
    shared: dict[str, Any] = {"pixel_size": pair.pixel_size, "progress": progress}
    kept = estimation.model_dump(include={"scales", "factor", "limits", "local_window"})
    plain = Estimation(method="paper", beta=0.0, warps=estimation.warps, **kept)
    standard = estimate_displacement(I1, I2, plain, dead=scene.dead, **shared).u
    guess = standard if scene.background is None else scene.background
    bubbles = track(I1, I2, tracking, prediction=guess)
    bubbles = bubbles[~scene.dead[_nearest(bubbles.x2), _nearest(bubbles.x1)]]
    if bubbles.empty:
        raise InputError("mask: leaves no bubble; make it smaller, or lower the threshold")
    known: dict[str, Any] = {"bubbles": bubbles, "edges": scene.edges, "dead": scene.dead}
    stiffness, deviation, modulus_deviation = None, None, None
    if identification is not None:
        stiffness = identify_stiffness(
            I1, I2, scene.sample, identification, estimation, **known, **shared
        )
        estimate = stiffness.estimate
        if pair.error_bars:
            deviation, modulus_deviation = deviations(stiffness, samples=pair.error_bars)
    else:
        estimate = estimate_displacement(
            I1, I2, estimation, background=scene.background, **known, **shared
        )
        if pair.error_bars:
            deviation = estimate.deviation(pair.error_bars)
    back = bubbles.assign(
        x1=bubbles.x1 + bubbles.u1, x2=bubbles.x2 + bubbles.u2, u1=-bubbles.u1, u2=-bubbles.u2
    )
    back = back[inside(I2.shape, back[["x1", "x2"]].to_numpy().T)]
    # What the way there knew, the way back knows too.
    u_bg = scene.background if stiffness is None else stiffness.elastic
    scale = 1.0 if stiffness is None else stiffness.scale
    w = estimate_displacement(
        I2,
        I1,
        estimation.model_copy(update={"alpha": estimate.alpha}),
        bubbles=back,
        background=None if u_bg is None else -warp_field(u_bg, -u_bg),
        edges={edge: -scale * g for edge, g in scene.edges.items()},
        dead=scene.dead,
        **shared,
    ).u
    return Step(
        estimate,
        deviation,
        standard,
        bubbles,
        inconsistency(estimate.u, w),
        stiffness,
        modulus_deviation,
    )


def _nearest(x: pd.Series) -> NDArray[np.int64]:
    return x.round().to_numpy().astype(np.int64)


def _summary(
    pair: Pair, scene: Scene, steps: list[Step], u: Array, e: Array, window: float
) -> dict[str, Any]:
    def span(values: Array) -> list[float]:
        return [float(values.min()), float(values.max())]

    errors = np.concatenate([step.inconsistency[~scene.dead] for step in steps])
    return {
        "images": [pair.frames] if pair.frames else [pair.reference, pair.deformed],
        "size_px": [u.shape[2], u.shape[1]],
        "pixel_size_um": list(pair.pixel_size),
        "steps": len(steps),
        "bubbles": [len(step.bubbles) for step in steps],
        "bubble_quality_median": float(
            np.median(np.concatenate([s.bubbles.quality for s in steps]))
        ),
        "alpha": [step.estimate.alpha for step in steps],
        "u1_range_px": span(u[0]),
        "u2_range_px": span(u[1]),
        "u1_range_um": span(u[0] * pair.lateral_size),
        "u2_range_um": span(u[1] * pair.axial_size),
        "strain_filter": FILTER,
        "strain_window_um": window,
        "axial_strain_mean": float(e[1].mean()),
        "dead_share": float(scene.dead.mean()),
        "forward_backward_error_median_px": float(np.nanmedian(errors)),
    }
