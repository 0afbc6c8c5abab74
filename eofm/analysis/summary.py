"""What a reader wants to know first, as numbers: the summary of a pair or sequence."""

from collections.abc import Sequence
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np

from eofm.analysis.strain import FILTER
from eofm.analysis.tensors import invariants, labels
from eofm.errors import InputError
from eofm.flow.start import REACH
from eofm.grid import Array, Mask
from eofm.imaging.defects import defects_by_kind, filled
from eofm.imaging.intensity import looks_linear
from eofm.settings import Estimation, Measures

if TYPE_CHECKING:
    from eofm.analysis.step import Step

# Share of the images in the estimate, and their correlation, below which the regulariser holds a
# pixel alone. Where they match, a small share says that there is no detail, not that nothing is
# known.
HELD, MATCHED = 0.1, 0.5
# Percentiles that stand for the range of a strain.
RANGE = (1, 99)
# What changes along each axis of a volume; of an image, the last two.
LINES = "slices", "rows", "columns"


def length(u: Array) -> Array:
    """Lengths of vectors, shape (components, ...)."""
    return reduce(np.hypot, u)


def of_motion(
    pixel_size: tuple[float, ...], dead: Mask, steps: "Sequence[Step]", u: Array
) -> dict[str, Any]:
    """Size, bubbles, ranges of the displacement, and what each step says of itself."""
    errors = np.concatenate([step.inconsistency[~dead] for step in steps])
    quality = np.concatenate([step.bubbles.quality for step in steps])
    live = u[:, ~dead]
    ranges = {f"u{i + 1}_range_px": _span(c) for i, c in enumerate(live)}
    ranges |= {f"u{i + 1}_range_um": _span(c * pixel_size[i]) for i, c in enumerate(live)}
    return {
        "size_px": list(u.shape[:0:-1]),
        "pixel_size_um": list(pixel_size),
        # Equal sides of 1 are what `Known` has where nobody says anything.
        "pixel_size_from": "known" if set(pixel_size) != {1.0} else None,
        "steps": len(steps),
        "bubbles": [len(step.bubbles) for step in steps],
        "bubbles_found": [step.found for step in steps],
        "bubble_quality_median": float(np.median(quality)) if quality.size else None,
        "alpha": [step.estimate.alpha for step in steps],
        **ranges,
        "largest_motion_px": [float(np.abs(c).max()) for c in live],
        "dead_share": float(dead.mean()),
        "forward_backward_error_median_px": float(np.nanmedian(errors)),
        "trust": [step.trust.summary() for step in steps],
    }


def of_strain(e: Array, measures: Measures, window: float, left_out: Mask) -> dict[str, Any]:
    """Mean and range of each strain and of what does not depend on the axes.

    Of what the images show: air, in which the field was filled in, is no part of the sample.
    """
    seen = ~left_out if not left_out.all() else ~np.zeros_like(left_out)
    n = e.ndim - 1
    named = dict(zip(labels(n), e, strict=True)) | invariants(e, measures.strain_measure)
    ranges = {}
    for name, values in named.items():
        live = values[seen]
        low, high = np.nanpercentile(live, RANGE)
        ranges[name] = {"mean": float(np.nanmean(live)), "low": float(low), "high": float(high)}
    return {
        "strain_filter": FILTER,
        "strain_window_um": window,
        "strain_measure": measures.strain_measure,
        "axial_strain_mean": ranges[labels(n)[1]]["mean"],
        "strains": ranges,
    }


def of_images(
    frames: Sequence[Array],
    dead: Mask,
    printed: Mask,
    lines: Sequence[int],
    residuals: tuple[Array, Array],
    share: Array,
    match: Array,
) -> dict[str, Any]:
    """What is left of their difference after and without the motion, and what they say."""
    seen, live = ~(dead | printed), ~dead
    after, without = (float(np.sqrt(np.nanmean(r[seen] ** 2))) for r in residuals)
    return {
        "residual_rms": after,
        "residual_rms_without_motion": without,
        # Of a detail as wide as sigma: tiny, and rightly so, where a smooth motion is averaged
        # over more. The pixels that are held tell what to doubt.
        "share_of_data_median": float(np.median(share[live])),
        "share_held_by_regulariser": float(held(share, match)[live].mean()),
        "looks_linear": looks_linear(frames[0]),
        "defect_share": [_defect_share(I, dead) for I in frames],
        "printed_share": float((printed & ~dead).mean()),
        "lines_taken_off": [LINES[-frames[0].ndim :][axis] for axis in lines],
    }


def _defect_share(I: Array, dead: Mask) -> dict[str, float]:
    """Parts of a frame that show the detector instead of the sample, by kind."""
    found = defects_by_kind(filled(I, dead))
    return {kind: float((mask & ~dead).mean()) for kind, mask in found.items() if mask.any()}


def held(share: Array, match: Array) -> Mask:
    """Pixels that the regulariser holds alone: the images have no share, and do not match."""
    return (share < HELD) & ~(match > MATCHED)


def reach(shape: tuple[int, ...], estimation: Estimation) -> list[float]:
    """Motions beyond which a step finds none by itself, px, lateral first.

    Those that blocks are searched for, or two samples of the coarsest scale.
    """
    if estimation.robust:
        return [REACH * n for n in shape[::-1]]
    coarsest = estimation.factor ** (1 - (estimation.scales or 1))
    return [min(2 * coarsest, n / 2) for n in shape[::-1]]


def of_stiffness(step: "Step") -> dict[str, Any]:
    """What the identification says of itself."""
    refused = {"refused": step.refused or None}
    if (found := step.stiffness) is None:
        return refused | {"modulus_range": None}
    return refused | {
        "modulus_range": None if found.refused else [float(found.E.min()), float(found.E.max())],
        "contrast_is_significant": found.contrast,
        "edges_sought": list(found.fit.problem.model.loose),
        "edge_motion_factor": found.scale,
        "gamma": found.gamma,
        "rounds": found.rounds,
        "last_change_of_u": found.change if np.isfinite(found.change) else None,
    }


def check_measures(measures: Measures, shape: tuple[int, ...], sides: Sequence[float]) -> None:
    """Refuse what cannot be made of frames of a shape, before any work.

    Raises
    ------
    InputError
        If the window is wider than the frames, or the stiffness of a volume is wanted.
    """
    if len(shape) == 3 and measures.stiffness:
        raise InputError("stiffness: is identified of images only, not of volumes; leave it out")
    wide = max(n * p for n, p in zip(shape[::-1], sides, strict=False))
    if (measures.strain_window or 0) > wide:
        raise InputError(
            f"strain_window: {measures.strain_window:g} um is wider than the whole image"
        )


def _span(values: Array) -> list[float]:
    return [float(values.min()), float(values.max())]
