"""The prior of the modulus that bubbles which were held out ask for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eofm.grid import Array
from eofm.identification.folds import Folds
from eofm.identification.inclusions import Outlined, no_inclusions, one_more, outline
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
# Inclusions that are sought, at most.
MOST = 6
# Places at which each is tried: neither way always ends at the best ones, and bubbles tell.
PLACES = 1, 3
# Gain below which fits that are only compared stop, in units of ``least_gain``: they rank weights
# long before they have converged.
COMPARED = 4.0
# Standard errors by which a prior may be worse and is yet not ruled out.
RIVAL = 1.0


@dataclass(frozen=True)
class Fit:
    """What an inversion with a prior finds.

    Attributes
    ----------
    problem : Inversion
        With the weights of the total variation.
    z : ndarray
    outlined : Outlined, optional
        The inclusions of which it consists, if it does.
    """

    problem: Inversion
    z: Array
    outlined: Outlined | None = None

    @property
    def u(self) -> Array:
        """Its displacement, shape (2, height, width), true lengths."""
        return self.problem.u(self.problem.state(self.z))

    @property
    def log_E(self) -> Array:
        """Logarithm of the modulus relative to the background's (the median) at the pixels."""
        log_E = self.problem.log_E(self.z)
        return self.problem.model.elements_to_pixels(log_E - np.median(log_E))

    @property
    def misfit(self) -> float:
        """What its displacement leaves of the images, squared, in variances of their noise."""
        return float((self.problem.left(self.problem.state(self.z)) ** 2).sum())


@dataclass(frozen=True)
class Prior:
    """What is known of the modulus before the images are seen.

    Attributes
    ----------
    gamma : float
        Weight of the total variation; `NONE` leaves a homogeneous sample.
    sharper : float
        If not 0, outlines are relaxed afterwards, with the weight times this.
    inclusions : int
        If not 0, the modulus is that of so many inclusions with smooth outlines instead.
    places : int
        At how many places each of them is tried.
    """

    gamma: float
    sharper: float = 0.0
    inclusions: int = 0
    places: int = 1

    def fit(self, start: Fit, settings: Identification, report: Report) -> Fit:
        """Return what an inversion finds from the fit with another prior."""
        problem, z = start.problem, start.z
        if self.inclusions:
            found = start.outlined or no_inclusions(problem, z)
            for _ in range(self.inclusions - found.inclusions.count):
                found = one_more(found, self.places, settings, report)
            return Fit(problem, found.z, found)
        z = gauss_newton(problem, z, self.gamma, settings, report)
        for _ in range(ROUNDS if self.sharper else 0):
            problem = problem.relaxed(z)
            z = gauss_newton(problem, z, self.weight, settings, report)
        return Fit(problem, z)

    def again(self, fit: Fit, problem: Inversion, settings: Identification, report: Report) -> Fit:
        """Return what an inversion about another estimate finds from the fit of one before."""
        if fit.outlined:
            found = outline(fit.outlined.inclusions.on(problem), settings, report)
            return Fit(problem, found.z, found)
        problem = replace(problem, weights=fit.problem.weights)
        return Fit(problem, gauss_newton(problem, fit.z, self.weight, settings, report))

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
    fits : list of Fit
        What each fold finds with it.
    losses : ndarray
        Of each bubble.
    rivals : tuple of list of Fit
        What each fold finds with other priors that held-out bubbles do not rule out.
    """

    prior: Prior
    fits: list[Fit]
    losses: Array
    rivals: tuple[list[Fit], ...] = ()

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

    def attempt(prior: Prior, start: list[Fit]) -> Choice:
        fits = [prior.fit(fit, rough, report) for fit in start]
        return Choice(prior, fits, folds.losses([fit.u for fit in fits]))

    def going(tried: list[Choice]) -> bool:
        return len(tried) - 1 - int(np.argmin([c.score for c in tried])) < PATIENCE

    none = attempt(Prior(NONE), [Fit(p, p.start()) for p in parts])
    tried = [attempt(Prior(settings.gamma or high), none.fits)]
    while settings.gamma is None and tried[-1].prior.gamma / STEP >= low and going(tried):
        tried.append(attempt(Prior(tried[-1].prior.gamma / STEP), tried[-1].fits))
    found = strongest(tried, settings.clear)
    gamma = found.prior.gamma
    shaped = list[Choice]()
    for places in PLACES:
        row = [attempt(Prior(gamma, inclusions=1, places=places), none.fits)]
        while len(row) < MOST and going(row):
            more = replace(row[-1].prior, inclusions=len(row) + 1)
            row.append(attempt(more, row[-1].fits))
        shaped += row
    shaped.sort(key=lambda choice: (choice.prior.inclusions, choice.score))
    simple, sharp = strongest(shaped, RIVAL), list[Choice]()
    if clearly_better(found.losses, simple.losses, RIVAL):
        middle = attempt(Prior(gamma, SHARPER[1]), found.fits)
        better = middle.score < found.score
        other = attempt(Prior(gamma, SHARPER[0 if better else 2]), found.fits)
        sharp = sorted([middle, other], key=lambda choice: -choice.prior.sharper)
        found = strongest([*sharp, found], settings.clear)
    else:
        found = simple
    if settings.gamma is None and not clearly_better(
        found.losses, none.losses, settings.significant
    ):
        found = none
    rivals = (c for c in (none, *tried, *sharp, *shaped) if c is not found)
    kept = [c.fits for c in rivals if not clearly_better(found.losses, c.losses, RIVAL)]
    return replace(found, rivals=tuple(kept))


def strongest(choices: Sequence[Choice], clear: float) -> Choice:
    """The first of some that none of the others is clearly better than."""
    best = min(choices, key=lambda choice: choice.score)
    return next(c for c in choices if not clearly_better(best.losses, c.losses, clear))
