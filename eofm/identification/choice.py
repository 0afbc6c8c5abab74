"""The prior of the modulus that bubbles which were held out ask for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eofm.grid import Array
from eofm.identification.folds import Folds
from eofm.identification.inversion import Inversion, Report, gauss_newton
from eofm.settings import Identification

# Ratio of weights that are compared.
STEP = 3.0
# Weights tried past the best so far.
PATIENCE = 1
# A weight that leaves a homogeneous sample.
NONE = 1e6
# Factors of the weight where outlines are relaxed, from strong to weak, and how often they are.
SHARPER = (27.0, 9.0, 3.0)
ROUNDS = 3
# Gain below which fits that are only compared stop, in units of ``least_gain``: they rank weights
# long before they have converged.
COMPARED = 4.0
# Standard errors by which a prior may be worse and is yet not ruled out.
RIVAL = 1.0


@dataclass(frozen=True)
class Prior:
    """How the modulus is kept smooth.

    Attributes
    ----------
    gamma : float
        Weight of the total variation; `NONE` leaves a homogeneous sample.
    sharper : float
        If not 0, outlines are relaxed afterwards, with the weight times this.
    """

    gamma: float
    sharper: float = 0.0

    def fit(
        self, problem: Inversion, z: Array, settings: Identification, report: Report
    ) -> tuple[Inversion, Array]:
        """Inversion whose outlines are relaxed, if they are, and its minimiser, from ``z``."""
        z = gauss_newton(problem, z, self.gamma, settings, report)
        for _ in range(ROUNDS if self.sharper else 0):
            problem = problem.relaxed(z)
            z = gauss_newton(problem, z, self.weight, settings, report)
        return problem, z

    @property
    def weight(self) -> float:
        """Of the total variation in the end."""
        return self.gamma * (self.sharper or 1.0)


@dataclass(frozen=True)
class Choice:
    """What held-out bubbles say.

    Attributes
    ----------
    prior : Prior
    z : list of ndarray
        What each fold finds with it.
    losses : ndarray
        Of each bubble.
    rivals : tuple of list of ndarray
        What each fold finds with other priors that held-out bubbles do not rule out.
    """

    prior: Prior
    z: list[Array]
    losses: Array
    rivals: tuple[list[Array], ...] = ()

    @property
    def score(self) -> float:
        """Mean logarithm of the losses: single bubbles far from all others do not decide."""
        return float(np.log1p(self.losses / 2).mean())


def clearly_better(a: Array, b: Array, clear: float) -> bool:
    """Whether losses ``a`` are below ``b`` by more than standard errors of the difference.

    Of paired bubbles, and of the logarithms of their losses: those of single bubbles that lie
    far from all others are a hundred times larger than most.
    """
    gain = np.log1p(b / 2) - np.log1p(a / 2)
    return float(gain.mean()) > clear * float(gain.std()) / np.sqrt(gain.size)


def choose(
    parts: Sequence[Inversion], folds: Folds, settings: Identification, report: Report
) -> Choice:
    """Prior whose displacement predicts bubbles that were held out.

    The weight falls from the largest by factors of 3, each fit the start of the next, until
    ``PATIENCE`` of them have brought nothing. Then outlines are relaxed, with the weight times
    the middle of ``SHARPER`` and, as that is better or not, the first or last. Of the fits that
    no other is clearly better than, the one with the strongest prior is taken (rule of one
    standard error, Breiman et al., Classification and Regression Trees, 1984, between paired
    bubbles).

    Parameters
    ----------
    parts : sequence of Inversion
        Without the bubbles of each part of the folds.
    folds : Folds
    """
    rough = settings.changed(least_gain=COMPARED * settings.least_gain)
    low, high = settings.gamma_range

    def attempt(prior: Prior, start: list[Array]) -> Choice:
        fits = [prior.fit(p, z, rough, report) for p, z in zip(parts, start, strict=True)]
        fields = [p.u(p.state(z)) for p, z in fits]
        return Choice(prior, [z for _, z in fits], folds.losses(fields))

    none = attempt(Prior(NONE), [p.start() for p in parts])
    tried = [attempt(Prior(settings.gamma or high), none.z)]
    while settings.gamma is None and tried[-1].prior.gamma / STEP >= low:
        tried.append(attempt(Prior(tried[-1].prior.gamma / STEP), tried[-1].z))
        scores = [choice.score for choice in tried]
        if len(tried) - 1 - int(np.argmin(scores)) >= PATIENCE:
            break
    found = strongest(tried, settings.clear)
    middle = attempt(Prior(found.prior.gamma, SHARPER[1]), found.z)
    better = middle.score < found.score
    other = attempt(Prior(found.prior.gamma, SHARPER[0 if better else 2]), found.z)
    sharp = sorted([middle, other], key=lambda choice: -choice.prior.sharper)
    found = strongest([*sharp, found], settings.clear)
    if settings.gamma is None and not clearly_better(
        found.losses, none.losses, settings.significant
    ):
        found = none
    rivals = (c for c in (none, *tried, *sharp) if c is not found)
    kept = [c.z for c in rivals if not clearly_better(found.losses, c.losses, RIVAL)]
    return replace(found, rivals=tuple(kept))


def strongest(choices: Sequence[Choice], clear: float) -> Choice:
    """The first of some that none of the others is clearly better than."""
    best = min(choices, key=lambda choice: choice.score)
    return next(c for c in choices if not clearly_better(best.losses, c.losses, clear))
