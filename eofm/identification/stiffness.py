"""Relative stiffness of a sample from two images, by regularised Gauss-Newton.

Minimises over ``m``, from which ``log E = L tanh(m / L)`` with ``L = ln 30``,

    int (I2(x + u_E) - I1)^2 dx / s^2 + gamma int sqrt(|grad m|^2 + epsilon^2) dx

with the elastic displacement u_E of the sample, the images' noise s, and the total
variation as prior, which allows sharp outlines. The images are linearised about an
estimate that already fits them (`eofm.flow.estimate`), so no false minimum can trap the search.
That estimate and the search take turns: the identified sample's displacement is the
background field of the next estimate, until the field settles.
"""

from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from eofm.elasticity.forward import press
from eofm.errors import InputError
from eofm.flow.estimate import estimate_displacement
from eofm.flow.found import Estimate
from eofm.flow.known import Known
from eofm.grid import FACES, Array, Edge, faces
from eofm.identification.choice import NONE, Choice, Fit, clearly_better
from eofm.identification.edges import move_differently, moved
from eofm.identification.folds import Folds
from eofm.identification.inversion import Report
from eofm.identification.setup import Setup
from eofm.identification.uncertainty import Errors
from eofm.settings import Estimation, Identification, Sample
from eofm.threads import serial

# Samples of the error bars that decide whether E is refused.
VERDICT_SAMPLES = 8
# Part of the clarity for which E is asked below which its displacement is no better either.
VAGUE = 0.75
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Stiffness:
    """An identified sample.

    Attributes
    ----------
    E : ndarray, shape (height, width)
        Modulus relative to the background's (the median); NaN where it is refused.
    elastic : ndarray, shape (2, height, width)
        Elastic displacement of the identified sample, px, even if it is refused.
    estimate : Estimate
        Test 6: the displacement estimated with that field as background.
    choice : Choice
        What held-out bubbles say.
    fit : Fit
        What was sought, and what it minimises, for error bars, see
        `eofm.identification.uncertainty`.
    scale : float
        Factor of the stated motion of the edges that the images ask for; 1 where they do
        not contradict it.
    rounds : int
        How often identification and estimate took turns.
    change : float
        Relative change of the displacement in the last round.
    refused : str
        Why E is not to be trusted; empty where it is.
    alone : bool
        Whether ``estimate`` is the preset's, which knows nothing of E.
    """

    E: Array
    elastic: Array
    estimate: Estimate
    choice: Choice
    fit: Fit
    scale: float = 1.0
    rounds: int = 0
    change: float = np.inf
    refused: str = ""
    alone: bool = False

    @property
    def errors(self) -> Errors:
        """Error bars, of the displacement and of E."""
        return Errors(self.fit, self.choice)

    @property
    def clarity(self) -> float:
        """Root mean square of log E relative to that of its standard deviation."""
        deviation = self.errors.deviations(VERDICT_SAMPLES, seed=0)[1]
        return float(np.sqrt((np.log(self.E) ** 2).mean() / ((deviation**2).mean() + TINY)))

    @property
    def gamma(self) -> float:
        """Weight of the total variation."""
        return self.choice.prior.weight

    @property
    def contrast(self) -> bool:
        """Whether a contrast of the modulus is significant."""
        return self.gamma < NONE

    def summary(self) -> str:
        """What came out and why it stopped, in a line."""
        if self.refused:
            whose = "the preset's" if self.alone else "that of the identified sample"
            return f"E is refused: {self.refused}; the displacement is {whose}"
        scaled = (
            "" if self.scale == 1 else f"; edges moved by {self.scale:.3f} times of what was said"
        )
        found = (
            f"E from {self.E.min():.2g} to {self.E.max():.2g} of the background's; gamma"
            f" {self.gamma:.2g}"
            if self.contrast
            else "no significant contrast of E"
        )
        return (
            f"{found}; {self.rounds} rounds, the last of which changed u by"
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
    """Relative modulus of a sample, or of a part of one, and test 6.

    Parameters
    ----------
    I1, I2 : ndarray, shape (height, width)
        Images of the whole sample, or of a part of it, before and after compression.
    sample : Sample
        Size of what the images show, Poisson ratio, contact and motion of the bottom; its
        inclusions are not used.
    settings : Identification
    estimation : Estimation
        How the displacement is estimated.
    known : Known
        Bubbles, dead zones, size of the pixels, and the motion of edges; without any, and
        nothing outside, the top is fixed and the bottom moves up by the sample's compression.
        The motion of edges outside, or known in part alone, is sought as well, and so is that of
        all edges of which nothing is known unless two of them are known to move differently; only
        then its background is used. Other edges are free.
    progress : bool
        Show a progress bar, if standard error is a terminal.

    Raises
    ------
    InputError
        If the images are not of the sample's size.
    UndeterminedError
        If they contradict the motion of the edges.

    Notes
    -----
    Where the images clearly contradict the stated motion of the edges by more than
    ``settings.trust``, all of it is multiplied by the factor for which they ask.

    The weight gamma and the start are chosen on bubbles held out, see `choose`. They also
    decide whether a contrast is significant; and where the field that they find predicts
    them worse than the preset, that one's is returned, with the reason. E is refused as well
    where its contrast does not stand out from its error bars.
    """
    _check(I1, I2, sample)
    if estimation.ends == "half":
        raise InputError("ends: the stiffness wants an estimate that ends at 'full' resolution")
    bar = tqdm(desc="stiffness", unit="step", disable=None if progress else True)

    def report(gamma: float, step: int, gain: float) -> None:
        bar.update()
        bar.set_postfix_str(f"gamma {gamma:.2g}, step {step}, gain {gain:.3g}")

    stated = dict(known.edges) or (press(sample) if not known.outside else {})
    partly = tuple(edge for edge, g in known.edges.items() if np.isnan(g).any())
    if known.outside or partly or not move_differently(stated):
        loose: tuple[Edge, ...] = (*known.outside, *partly) or tuple(faces(2))
        loose = tuple(e for e in loose if e in partly or e not in known.edges)
        scale, u_bg = 1.0, known.background
        u_bg = np.zeros((2, *I1.shape)) if u_bg is None else u_bg
        estimate = estimate_displacement(I1, I2, estimation, known)
        rim = {edge: estimate.u[:, *FACES[edge].pixels()] for edge in loose}
        motion = dict(known.edges) | rim
    else:
        loose = ()
        scale, motion, u_bg = moved(I1, I2, sample, settings, estimation, known, stated)
        # A contact that slips leaves the motion along the edge open.
        known = replace(known, edges={} if sample.contact == "slip" else motion)
        estimate = estimate_displacement(I1, I2, estimation, replace(known, background=u_bg))
    setup = Setup(sample, motion, loose, u_bg, known.sides(2), settings)
    choice, refused = setup.choose(estimate, report)
    found: Stiffness | None = None
    alone = bool(refused)
    for rounds in range(1, settings.rounds + 1):
        found = _identify(setup, estimate, choice, found, report)
        if rounds == 1 and found.contrast and not refused:
            refused, alone = vague(found, settings)
        found = replace(found, scale=scale, rounds=rounds, refused=refused, alone=alone)
        if alone:
            break
        last = estimate.u
        estimate = estimate_displacement(
            I1, I2, estimation, replace(known, background=found.elastic)
        )
        change = float(np.linalg.norm(estimate.u - last) / np.linalg.norm(last))
        found = replace(found, estimate=estimate, change=change)
        if change <= settings.settled:
            break
    bar.close()
    assert found is not None  # there is at least one round
    found = found if alone else _settle(found, settings)
    return replace(found, E=np.full_like(found.E, np.nan)) if refused else found


def _identify(
    setup: Setup, estimate: Estimate, choice: Choice, previous: Stiffness | None, report: Report
) -> Stiffness:
    """The sample that fits the images, linearised about an estimate."""
    everything, prior = np.ones(setup.sample.shape, dtype=bool), choice.prior
    if previous and previous.fit.outlined:
        setup = setup.finer
    whole = setup.problems(estimate, [everything])[0]
    if previous is None:
        fit = setup.first(whole, estimate, choice, report)
    else:
        fit = prior.again(previous.fit, whole, setup.settings, report)
    return Stiffness(np.exp(fit.log_E), fit.u / setup.h, estimate, choice, fit)


def _settle(found: Stiffness, settings: Identification) -> Stiffness:
    """The same with the elastic displacement, where it predicts bubbles held out better.

    The estimate about it has a weight that blocks of pixels chose, and may follow noise.
    """
    folds = Folds(found.estimate.match)
    fields = [fit.u for fit in found.choice.fits]
    smooth = folds.losses(folds.smooth(found.estimate, fields))
    if not clearly_better(folds.losses(fields), smooth, settings.clear):
        return found
    return replace(found, estimate=replace(found.estimate, u=found.elastic))


def vague(found: Stiffness, settings: Identification) -> tuple[str, bool]:
    """Why error bars do not bear E out, and whether not even its displacement; empty if they do.

    The few numbers of inclusions are borne out by the bubbles that chose them.
    """
    if found.fit.outlined:
        return "", False
    clarity = found.clarity
    if clarity >= settings.clarity:
        return "", False
    return (
        f"its contrast is {clarity:.2g} times its error bars, less than {settings.clarity:g}"
    ), clarity < VAGUE * settings.clarity


def _check(I1: Array, I2: Array, sample: Sample) -> None:
    for name, I in (("before", I1), ("after", I2)):
        if I.shape != sample.shape:
            raise InputError(
                f"the image {name} compression has {I.shape[0]} x {I.shape[1]} px but the sample"
                f" {sample.height} x {sample.width} px; they have to be the same"
            )
