"""Relative stiffness of a sample from two images, by regularised Gauss-Newton.

Minimises over ``m``, from which ``log E = L tanh(m / L)`` with ``L = ln 30``,

    int (I2(x + u_E) - I1)^2 dx / s^2 + gamma int sqrt(|grad m|^2 + epsilon^2) dx

with the elastic displacement u_E of the sample, the images' noise s, and the total
variation as prior, which allows sharp outlines. The images are linearised about an
estimate that already fits them (`eofm.preset`), so no false minimum can trap the search.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eofm.config import Forward, Identification, Preset, Sample
from eofm.elasticity import background_field
from eofm.errors import InputError
from eofm.functional import Grid, Pointwise
from eofm.images import normalise
from eofm.inversion import LARGEST, Problem, choose_gamma, gauss_newton
from eofm.preset import Estimate, ImagePair, estimate_preset, held_out
from eofm.sensitivity import Elastic

Array = NDArray[np.float64]

# Part of the compression by which the images may contradict the motion of the edges.
DOUBT = 0.2


@dataclass(frozen=True)
class Stiffness:
    """An identified sample.

    Attributes
    ----------
    E : ndarray, shape (height, width)
        Modulus relative to the background's (the median).
    u : ndarray, shape (2, height, width)
        Its elastic displacement, px.
    gamma : float
        Weight of the total variation.
    m : ndarray
        What was sought, one value per element.
    problem : Problem
        What it minimises, for error bars, see `eofm.uncertainty`.
    """

    E: Array
    u: Array
    gamma: float
    m: Array
    problem: Problem


def identify_stiffness(
    I1: Array,
    I2: Array,
    sample: Sample,
    *,
    bubbles: pd.DataFrame | None = None,
    settings: Identification = Identification(),
    preset: Preset = Preset(zero_edges=("top", "bottom")),
    start: Estimate | None = None,
    previous: Stiffness | None = None,
) -> Stiffness:
    """Relative modulus of a sample whose top and bottom move by a known amount.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width)
        Images before and after compression.
    sample : Sample
        Size, Poisson ratio, contact and motion of the bottom; its inclusions are not used.
    bubbles : DataFrame, optional
        Tracked bubbles for the estimate that starts the search, see `estimate_preset`.
    settings : Identification
    preset : Preset
        How that estimate is made; its ``zero_edges`` have to name top and bottom.
    start : Estimate, optional
        That estimate, where there is one already.
    previous : Stiffness, optional
        Result of an earlier round, which gives the weight and the start.

    Raises
    ------
    InputError
        If the images are not of the sample's size, the motion of top and bottom is not
        said to be known, or the images contradict it.

    Notes
    -----
    The weight is divided by 3 until that no longer clearly lowers the misfit on held-out
    blocks, see `choose_gamma`; each minimum is the start of the next.
    """
    _check(I1, I2, sample, preset)
    if start is None:
        sample = known_sample(I1, I2, sample, settings, preset, bubbles)
    u_bg = background_field(sample, Forward())
    if start is None:
        start = estimate_preset(I1, I2, preset, bubbles=bubbles, background=u_bg)
    I1, I2 = normalise(I1, I2, preset.limits)
    pair = ImagePair(Grid(sample.shape), I1, I2, np.zeros_like(u_bg))
    model = Elastic(sample, settings.cell)
    mesh_error = model.to_pixels(model.solve(np.zeros(model.shape)).u) - u_bg

    def problem(mask: NDArray[np.bool_] | bool) -> Problem:
        data = pair.density(start.u, mask)
        scaled = Pointwise(data.A / start.noise**2, data.b / start.noise**2)
        return Problem(model, -mesh_error, scaled, settings.epsilon)

    m, gamma = np.zeros(model.shape), settings.gamma
    if previous is not None:
        m, gamma = previous.m, previous.gamma
    elif gamma is None:
        out = held_out(sample.shape, preset.block)
        gamma, m = choose_gamma(
            problem(~out), lambda u: pair.block_misfits(u, preset.block), settings
        )
    whole = problem(True)
    m = gauss_newton(whole, m, gamma, settings)
    log_E = LARGEST * np.tanh(m / LARGEST)
    log_E = model.elements_to_pixels(log_E - np.median(log_E))
    return Stiffness(np.exp(log_E), whole.u(whole.state(m)), gamma, m, whole)


def estimate_identified(
    I1: Array,
    I2: Array,
    sample: Sample,
    *,
    bubbles: pd.DataFrame | None = None,
    settings: Identification = Identification(),
    preset: Preset = Preset(zero_edges=("top", "bottom")),
) -> tuple[Estimate, Stiffness]:
    """Test 6: the preset with the identified sample's field as background.

    Identification and estimate take turns until the field settles, the images being
    linearised about the last estimate. Parameters and errors as in `identify_stiffness`.
    """
    _check(I1, I2, sample, preset)
    sample = known_sample(I1, I2, sample, settings, preset, bubbles)
    u_bg = background_field(sample, Forward())
    estimate = estimate_preset(I1, I2, preset, bubbles=bubbles, background=u_bg)
    found: Stiffness | None = None
    for _ in range(settings.rounds):
        found = identify_stiffness(
            I1, I2, sample, settings=settings, preset=preset, start=estimate, previous=found
        )
        last = estimate.u
        estimate = estimate_preset(I1, I2, preset, bubbles=bubbles, background=found.u)
        change = np.linalg.norm(estimate.u - last)
        if change <= settings.settled * np.linalg.norm(last):
            break
    assert found is not None  # there is at least one round
    return estimate, found


def edge_motion(
    I1: Array,
    I2: Array,
    sample: Sample,
    preset: Preset,
    bubbles: pd.DataFrame | None = None,
) -> tuple[float, float]:
    """Median axial motion of top and bottom in an estimate that does not know it, px."""
    free = preset.model_copy(update={"zero_edges": ()})
    u_bg = background_field(sample, Forward())
    u = estimate_preset(I1, I2, free, bubbles=bubbles, background=u_bg).u
    return float(np.median(u[1, 0])), float(np.median(u[1, -1]))


def known_sample(
    I1: Array,
    I2: Array,
    sample: Sample,
    settings: Identification,
    preset: Preset,
    bubbles: pd.DataFrame | None = None,
) -> Sample:
    """Check the sample's compression against the images, or read it from them.

    Raises
    ------
    InputError
        If the images contradict the motion of an edge by more than ``DOUBT`` of the
        compression and by more than half a px.
    """
    top, bottom = edge_motion(I1, I2, sample, preset, bubbles)
    if settings.fit_compression:
        sample = sample.model_copy(update={"compression": top - bottom})
    wrong = max(abs(top), abs(bottom + sample.compression))
    if wrong > max(DOUBT * abs(sample.compression), 0.5):
        raise InputError(
            f"the images contradict the motion of the edges by {wrong:.2f} px; stiffness"
            f" needs a compression (now {sample.compression:g} px) that is known better,"
            " or fit_compression"
        )
    return sample


def _check(I1: Array, I2: Array, sample: Sample, preset: Preset) -> None:
    for name, I in (("before", I1), ("after", I2)):
        if I.shape != sample.shape:
            raise InputError(
                f"the image {name} compression has {I.shape[0]} x {I.shape[1]} px but the sample"
                f" {sample.height} x {sample.width} px; they have to be the same"
            )
    if not {"top", "bottom"} <= set(preset.zero_edges):
        raise InputError(
            "stiffness needs the motion of the top and of the bottom; name both in zero_edges"
            " if the sample's compression is known, or use the preset without identification"
        )
    if sample.compression == 0:
        raise InputError("the compression is 0 px: a sample at rest does not show its stiffness")
