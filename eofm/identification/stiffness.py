"""Relative stiffness of a sample from two images, by regularised Gauss-Newton.

Minimises over ``m``, from which ``log E = L tanh(m / L)`` with ``L = ln 30``,

    int (I2(x + u_E) - I1)^2 dx / s^2 + gamma int sqrt(|grad m|^2 + epsilon^2) dx

with the elastic displacement u_E of the sample, the images' noise s, and the total
variation as prior, which allows sharp outlines. The images are linearised about an
estimate that already fits them (`eofm.flow.estimate`), so no false minimum can trap the search.
That estimate and the search take turns: the identified sample's displacement is the
background field of the next estimate, until the field settles.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from eofm.elasticity.forward import deform, press
from eofm.elasticity.sensitivity import Elastic
from eofm.errors import InputError
from eofm.flow.estimate import Estimate, estimate_displacement
from eofm.flow.functional import Pointwise
from eofm.flow.known import Known
from eofm.flow.matching import held_out
from eofm.grid import FACES, Array, Edge, componentwise, unit_spacing
from eofm.identification.inversion import LARGEST, Problem, Report, choose_gamma, gauss_newton
from eofm.settings import Estimation, Identification, Sample
from eofm.threads import serial

if TYPE_CHECKING:
    pass


# Contradictions smaller than this are none, px.
UNCERTAIN = 0.5
# Least and largest side of the blocks that are held out to choose gamma, px, and their number
# where the image has room. Large ones hold whole bubbles: what half of a bubble gets wrong, as
# it moves without being strained, its other half does too.
BLOCK, BLOCKS = (8, 16), 50
# Elements at most, where their size is left open: their matrix is factorised many times.
ELEMENTS = 6400
# Smallest side of an element then, px.
SMALLEST = 2.5


@dataclass(frozen=True)
class Stiffness:
    """An identified sample.

    Attributes
    ----------
    E : ndarray, shape (height, width)
        Modulus relative to the background's (the median).
    elastic : ndarray, shape (2, height, width)
        Elastic displacement of the identified sample, px.
    estimate : Estimate
        Test 6: the displacement estimated with that field as background.
    scale : float
        Factor of the stated motion of the edges that the images ask for; 1 where they do
        not contradict it.
    gamma : float
        Weight of the total variation.
    m : ndarray
        What was sought, one value per element.
    problem : Problem
        What it minimises, for error bars, see `eofm.identification.uncertainty`.
    rounds : int
        How often identification and estimate took turns.
    change : float
        Relative change of the displacement in the last round.
    """

    E: Array
    elastic: Array
    estimate: Estimate
    scale: float
    gamma: float
    m: Array
    problem: Problem
    rounds: int = 0
    change: float = np.inf

    def summary(self) -> str:
        """What came out and why it stopped, in a line."""
        scaled = (
            "" if self.scale == 1 else f"; edges moved by {self.scale:.3f} times of what was said"
        )
        return (
            f"E from {self.E.min():.2g} to {self.E.max():.2g} of the background's; gamma"
            f" {self.gamma:.2g}; {self.rounds} rounds, the last of which changed u by"
            f" {100 * self.change:.2g} %{scaled}"
        )


@serial
def identify_stiffness(
    I1: Array,
    I2: Array,
    sample: Sample,
    settings: Identification = Identification(),
    estimation: Estimation = Estimation(),
    known: Known = Known(),
    *,
    progress: bool = False,
) -> Stiffness:
    """Relative modulus of a sample whose edges move in a known way, and test 6.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width)
        Images of the whole sample before and after compression.
    sample : Sample
        Size, Poisson ratio, contact and motion of the bottom; its inclusions are not used.
    settings : Identification
    estimation : Estimation
        How the displacement is estimated.
    known : Known
        Bubbles, dead zones, size of the pixels, and the motion of edges; without any, the top
        is fixed and the bottom moves up by the sample's compression. Its background is not used.
    progress : bool
        Show a progress bar, if standard error is a terminal.

    Raises
    ------
    InputError
        If the images are not of the sample's size, fewer than two edges are known to move
        differently, or the images contradict their motion.

    Notes
    -----
    Where the images contradict the stated motion of the edges by more than
    ``settings.trust``, all of it is multiplied by the factor for which they ask.

    The weight gamma is divided by 3 until that no longer clearly lowers the misfit on
    held-out pixels, see `choose_gamma`; each fit is the start of the next.
    """
    motion = dict(known.edges) or press(sample)
    pixel_size = known.pixel_size
    _check(I1, I2, sample, motion)
    if estimation.ends == "half":
        raise InputError("ends: the stiffness wants an estimate that ends at 'full' resolution")
    slip = sample.contact == "slip"
    u_bg = deform(sample, motion, pixel_size=pixel_size, slip=slip)
    bar = tqdm(desc="stiffness", unit="step", disable=None if progress else True)

    def report(gamma: float, step: int, gain: float) -> None:
        bar.update()
        bar.set_postfix_str(f"gamma {gamma:.2g}, step {step}, gain {gain:.3g}")

    blind = estimation.changed(zero_edges=())
    free = estimate_displacement(I1, I2, blind, replace(known, background=u_bg, edges={}))
    scale = _scale(free, u_bg, motion, settings)
    motion, u_bg = {edge: scale * g for edge, g in motion.items()}, scale * u_bg
    # A contact that slips leaves the motion along the edge open.
    known = replace(known, edges={} if slip else motion)
    estimate = estimate_displacement(I1, I2, estimation, replace(known, background=u_bg))
    found: Stiffness | None = None
    for rounds in range(1, settings.rounds + 1):
        found = _identify(sample, motion, u_bg, estimate, settings, pixel_size, found, report)
        last = estimate.u
        estimate = estimate_displacement(
            I1, I2, estimation, replace(known, background=found.elastic)
        )
        change = float(np.linalg.norm(estimate.u - last) / np.linalg.norm(last))
        found = replace(found, estimate=estimate, scale=scale, rounds=rounds, change=change)
        if change <= settings.settled:
            break
    bar.close()
    assert found is not None  # there is at least one round
    return found


def _identify(
    sample: Sample,
    motion: dict[Edge, Array],
    u_bg: Array,
    estimate: Estimate,
    settings: Identification,
    pixel_size: tuple[float, float],
    previous: Stiffness | None,
    report: Report,
) -> Stiffness:
    """The sample that fits the images, linearised about an estimate."""
    spacing = unit_spacing(pixel_size)
    h = componentwise(spacing, 2)
    match = estimate.match
    cell = settings.cell or max(SMALLEST, np.sqrt(match.r.size / ELEMENTS))
    true_lengths = {edge: h[..., 0] * g for edge, g in motion.items()}
    model = Elastic(sample, true_lengths, cell, spacing)
    # What the mesh gets wrong where E = 1.
    correction = h * u_bg - model.to_pixels(model.solve(np.zeros(model.shape)).u)

    def problem(mask: NDArray[np.bool_]) -> Problem:
        data = match.density(np.zeros_like(u_bg), mask)
        scaled = Pointwise(data.A / match.noise**2, data.b / match.noise**2)
        return Problem(model, correction, scaled, settings.epsilon)

    m, gamma = np.zeros(model.shape), settings.gamma
    if previous is not None:
        m, gamma = previous.m, previous.gamma
    if gamma is None:
        block = int(np.clip(np.sqrt(match.r.size / BLOCKS), *BLOCK))
        folds = [held_out(match.grid.shape, fold, block) for fold in range(4)]
        misfits = partial(match.block_misfits, block=block)
        gamma = choose_gamma(problem, misfits, folds, settings, report)
    whole = problem(np.ones(match.used.shape, dtype=bool))
    m = gauss_newton(whole, m, gamma, settings, report)
    log_E = LARGEST * np.tanh(m / LARGEST)
    log_E = model.elements_to_pixels(log_E - np.median(log_E))
    elastic = whole.u(whole.state(m)) / h
    return Stiffness(np.exp(log_E), elastic, estimate, 1.0, gamma, m, whole)


def _check(I1: Array, I2: Array, sample: Sample, motion: dict[Edge, Array]) -> None:
    for name, I in (("before", I1), ("after", I2)):
        if I.shape != sample.shape:
            raise InputError(
                f"the image {name} compression has {I.shape[0]} x {I.shape[1]} px but the sample"
                f" {sample.height} x {sample.width} px; they have to be the same"
            )
    means = np.array([g.mean(1) for g in motion.values()])
    if len(means) < 2 or not np.ptp(means, axis=0).any():
        raise InputError(
            "stiffness needs two edges that are known to move differently, such as a fixed top"
            " and a moved bottom: a sample at rest does not show its stiffness"
        )


def _scale(free: Estimate, u_bg: Array, edges: Iterable[Edge], settings: Identification) -> float:
    """Factor of the edges' motion for which the images ask, 1 where it is near 1.

    ``free`` does not know the edges. The factor is the least squares fit of the medians along
    them, less their mean, to those of the stated motion.

    Raises
    ------
    InputError
        If the images contradict the motion of an edge by more than ``settings.doubt``, or the
        edges move alike over most of their length.
    """

    def medians(v: Array) -> Array:
        return np.array([np.median(v[:, *FACES[edge].pixels()], axis=1) for edge in edges])

    seen, stated = medians(free.u), medians(u_bg)
    a, b = seen - seen.mean(0), stated - stated.mean(0)
    largest = float(np.abs(stated).max())
    if np.abs(b).max() <= 0.01 * largest:
        raise InputError(
            "stiffness cannot be told from edges most of which move alike; it needs two that move"
            " differently over most of their length"
        )
    scale = float((a * b).sum() / (b * b).sum())
    wrong = float(np.abs(seen - stated).max())
    if wrong > max(settings.doubt * largest, UNCERTAIN) or abs(scale - 1) > settings.doubt:
        raise InputError(
            f"the images contradict the motion of the edges by {wrong:.2f} px and would have"
            f" {scale:.3f} times of it; state it better, or raise the doubt ({settings.doubt:g})"
        )
    return 1.0 if abs(scale - 1) <= settings.trust else scale
