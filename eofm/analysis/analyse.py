"""Your own images: all results of a pair or a sequence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eofm.analysis import summary
from eofm.analysis.quality import data_share, residual
from eofm.analysis.step import Step, follow
from eofm.analysis.strain import strain
from eofm.errors import InputError
from eofm.flow.images import normalised
from eofm.flow.known import Known
from eofm.flow.trust import Trust
from eofm.grid import FACES, Array, Mask, geometric_mean, precision
from eofm.imaging.splines import warp_field
from eofm.settings import Estimation, Identification, Measures, Sample, Tracking

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Analysis:
    """Results of a pair or a sequence of images, or of volumes, which have one more axis.

    Attributes
    ----------
    first, last : ndarray, shape (height, width)
        First and last frame.
    dead : ndarray of bool, shape (height, width)
        Pixels of the first frame that carry no data.
    pixel_size : (lateral, axial) or (lateral, axial, elevational)
        Sides of a pixel, um.
    u : ndarray, shape (2, height, width)
        Displacement from the first frame to the last, px.
    deviation : ndarray, shape (2, height, width), or None
        Its standard deviation, px; errors of steps count as independent.
    steps : list of Step
        The results of each step.
    strain : ndarray, shape (3, height, width)
        Lateral, axial and shear strain of ``u``; of a volume six, see
        :func:`eofm.analysis.strain.strain`.
    residual, share : ndarray, shape (height, width)
        Difference of the warped last frame from the first; share of the data.
    summary : dict
        What a reader wants to know first.
    """

    first: Array
    last: Array
    dead: Mask
    pixel_size: tuple[float, ...]
    u: Array
    deviation: Array | None
    steps: list[Step]
    strain: Array
    residual: Array
    share: Array
    summary: dict[str, Any]

    @property
    def trust(self) -> Trust:
        """The verdict of the step with the worst one; of several, why, and in which ones."""
        trust, count = worst(self.steps), len(self.steps)
        if count == 1:
            return trust
        reasons = (
            f"step {k} of {count} (frames {k} and {k + 1}): {step.trust.reasons[0]}"
            for k, step in enumerate(self.steps, 1)
            if step.trust.verdict == trust.verdict != "good"
        )
        return replace(trust, reasons=tuple(reasons))

    def draw(self) -> "dict[str, Figure]":
        """Return the figures by name: pair, displacement, strain, quality and stiffness."""
        from eofm.analysis.report import draw

        return draw(self)

    def write(
        self, folder: Path, images: Sequence[str] = (), kinds: Sequence[str] = ("png", "pdf")
    ) -> None:
        """Write fields, tables, summary and figures, see `eofm.analysis.report`.

        The summary names the ``images`` they come from; figures are files of some ``kinds``.
        """
        from eofm.analysis.report import write_results

        write_results(self, folder, images, kinds)


def worst(steps: Sequence[Step]) -> Trust:
    """What the images say of the step that they bear out least."""
    order = ("good", "doubtful", "failed")
    return max((step.trust for step in steps), key=lambda t: order.index(t.verdict))


def analyse(
    *frames: Array,
    known: Known = Known(),
    sample: Sample | None = None,
    measures: Measures = Measures(),
    tracking: Tracking = Tracking(),
    estimation: Estimation = Estimation(),
    identification: Identification = Identification(),
    progress: bool = False,
) -> Analysis:
    """Displacement, strain and their quality for a pair or sequence of images.

    Parameters
    ----------
    *frames : ndarray, shape (height, width) or (depth, height, width)
        Images, or volumes, before and after compression, or more than two in the order of time.
    known : Known
        Edges, background and dead zones of the first frame, and the sides of a pixel in um.
        Motions are those of one step. Its bubbles are not used: they are tracked.
    sample : Sample, optional
        For the stiffness: size and materials of the sample; by default as large as the frames.
    measures : Measures
        What is made of the displacement: strain, error bars, stiffness.
    tracking, estimation, identification : Tracking, Estimation, Identification
        Settings of the steps.
    progress : bool
        Show progress bars, if standard error is a terminal.

    Raises
    ------
    InputError
        If there are fewer than two frames, or anything described cannot be used.

    Notes
    -----
    In a sequence, the motion of an edge is that of one step, and each step imposes it on
    the image's own rows and columns: right while the edge stays near them. The modulus
    is that of the first step, when the sample is where the image shows it.

    Examples
    --------
    >>> import numpy as np
    >>> import eofm
    >>> u = np.zeros((2, 40, 60))
    >>> u[1] = -0.02 * np.arange(40)[:, None]
    >>> before, after, _ = eofm.make_phantom(u, eofm.Phantom(seed=2))
    >>> results = eofm.analyse(before, after, known=eofm.Known(pixel_size=(5.0, 5.0)))
    >>> results.strain.shape
    (3, 40, 60)
    >>> round(results.summary["axial_strain_mean"], 2)
    -0.02
    """
    if len(frames) < 2:
        raise InputError(f"frames: wants two or more images, got {len(frames)}")
    shape = frames[0].shape
    pixel_size = known.sides(len(shape))
    summary.check_measures(measures, shape, pixel_size)
    dead = known.dead_on(shape)
    steps: list[Step] = []
    total, variance = (np.zeros((len(shape), *shape), precision(len(shape))) for _ in range(2))
    for I1, I2 in pairwise(frames):
        # Only of images is a stiffness wanted here.
        guess = sample or Sample(height=shape[-2], width=shape[-1])
        sought = (guess, identification) if measures.stiffness and not steps else None
        try:
            step = follow(
                I1, I2, known, tracking, estimation, sought, measures.error_bars, progress
            )
        except InputError as error:
            if len(frames) == 2:
                raise
            k = len(steps) + 1
            raise InputError(f"frames {k} and {k + 1}: {error}") from None
        steps.append(step)
        # What was at x is at x + total(x) now, and moves on from there.
        if step.deviation is not None:
            variance += np.maximum(warp_field(step.deviation**2, total), 0)
        total = total + warp_field(step.estimate.u, total)
        for edge in known.edges if estimation.edge_weight is None else ():
            on = FACES[edge].pixels(len(shape))
            there, stated = sum(s.estimate.u[:, *on] for s in steps), np.isfinite(known.edges[edge])
            total[:, *on] = np.where(stated, there, total[:, *on])
    first, last = frames[0], frames[-1]
    window = measures.strain_window or 3 * geometric_mean(pixel_size)
    e = strain(total, pixel_size, window, measures.strain_measure)
    left = residual(first, last, total)
    printed = reduce(np.logical_or, (step.estimate.printed for step in steps))
    lines = sorted({axis for step in steps for axis in step.estimate.lines})
    share = data_share(
        normalised(first, last, estimation, pixel_size)[0],
        estimation.smoothness,
        steps[-1].estimate.weight,
        estimation.sigma,
        known.spacing(len(shape)),
        dead | printed,
    )
    found = summary.of_motion(pixel_size, dead, steps, total)
    match = worst(steps).map
    found |= summary.of_strain(e, measures, window, dead | summary.held(share, match))
    without = residual(first, last, np.zeros_like(total))
    found |= summary.of_images(frames, dead, printed, lines, (left, without), share, match)
    found["reach_px"] = summary.reach(shape, estimation)
    if measures.stiffness:
        found["stiffness"] = summary.of_stiffness(steps[0])
    deviation = np.sqrt(variance) if measures.error_bars else None
    if deviation is not None:
        found["deviation_median_px"] = [float(np.median(d[~dead])) for d in deviation]
    return Analysis(first, last, dead, pixel_size, total, deviation, steps, e, left, share, found)
