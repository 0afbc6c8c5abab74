"""What all rounds of an identification share: the sample, its model, and what images say of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eofm.elasticity.sensitivity import Elastic
from eofm.flow.found import Estimate
from eofm.grid import Array, Edge, Mask, componentwise, unit_spacing
from eofm.identification.choice import NONE, Choice, Fit, choose, clearly_better
from eofm.identification.edges import motions
from eofm.identification.folds import COUNT, Folds
from eofm.identification.inversion import Inversion, Report, gauss_newton
from eofm.imaging.gaussian import blur
from eofm.imaging.splines import gradient, resize
from eofm.settings import Identification, Sample

# Elements at most, where their size is left open: their matrix is factorised many times.
ELEMENTS = 6400
# Smallest side of an element then, px.
SMALLEST = 4.0
# How much smaller their side is for the few numbers of inclusions, in the rounds after the first.
FINER = 2.0
# Largest contrast of a first guess.
STRONGEST = 8.0
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Setup:
    """What all rounds of an identification share.

    Attributes
    ----------
    sample : Sample
    motion : dict of ndarray, shape (2, n)
        Motion of edges, px; a first guess of those that are ``loose``.
    loose : tuple
    u_bg : ndarray, shape (2, height, width)
        Background of the estimate that knows no stiffness, px.
    pixel_size : (lateral, axial)
    settings : Identification
    """

    sample: Sample
    motion: dict[Edge, Array]
    loose: tuple[Edge, ...]
    u_bg: Array
    pixel_size: tuple[float, ...]
    settings: Identification

    @cached_property
    def h(self) -> Array:
        """Sides of a pixel, shape (2, 1, 1)."""
        return componentwise(unit_spacing(self.pixel_size), 2)

    @cached_property
    def model(self) -> Elastic:
        """The forward model, with the motion of edges in true lengths."""
        motion = {edge: self.h[..., 0] * g for edge, g in self.motion.items()}
        spacing = unit_spacing(self.pixel_size)
        return Elastic(self.sample, motion, self.cell, spacing, self.loose)

    @property
    def cell(self) -> float:
        """Side of an element, px."""
        sides = np.array(self.sample.shape) - 1
        return self.settings.cell or max(SMALLEST, float(np.sqrt(np.prod(sides) / ELEMENTS)))

    @cached_property
    def finer(self) -> "Setup":
        """The same on smaller elements: those that an outline cuts are a good part of a disc."""
        cell = max(self.cell / FINER, min(self.cell, 1.0))
        return replace(self, settings=self.settings.changed(cell=cell))

    def problems(self, estimate: Estimate, masks: Sequence[Mask]) -> list[Inversion]:
        """One for each mask of pixels that are seen."""
        model, match = self.model, estimate.match
        correction = np.zeros_like(self.u_bg)
        if not self.loose:
            # What the mesh gets wrong where E = 1.
            plain = model.to_pixels(model.solve(np.zeros(model.shape)).u)
            correction = self.h * self.u_bg - plain
        edges = motions(model, estimate, self.h)
        left = match.residual(np.zeros_like(self.u_bg))
        problems = []
        for mask in masks:
            g, r = (f * (match.used & mask) / match.noise for f in (match.g, left))
            problems.append(Inversion(model, correction, g, r, self.settings.epsilon, edges))
        return problems

    def choose(self, estimate: Estimate, report: Report) -> tuple[Choice, str]:
        """What held-out bubbles say, and why E is refused, if it is."""
        folds, settings = Folds(estimate.match), self.settings
        parts = self.problems(estimate, [~out for out in folds.masks])
        choice = choose(parts, folds, settings, report)
        preset = folds.losses(folds.smooth(estimate, [self.h * self.u_bg] * COUNT))
        if not clearly_better(preset, choice.losses, settings.worse):
            return choice, ""
        return choice, (
            "the identified sample predicts bubbles that were held out worse than the preset"
            f" (misfit {choice.losses.mean():.3g} against {preset.mean():.3g})"
        )

    def first(self, problem: Inversion, estimate: Estimate, choice: Choice, report: Report) -> Fit:
        """The best fit of some starts: what folds found, and for elements what strains suggest."""
        prior, settings = choice.prior, self.settings
        if prior.inclusions:
            outlined = [prior.again(fit, problem, settings, report) for fit in choice.fits]
            return min(outlined, key=lambda fit: fit.misfit)
        starts = [choice.fits[0].z]
        if prior.gamma < NONE:
            starts.append(problem.start(softness(estimate.u, problem.model)))
        fits = [gauss_newton(problem, z, prior.gamma, settings, report) for z in starts]
        best = min(fits, key=lambda z: problem.cost(z, problem.state(z), prior.gamma))
        return prior.fit(Fit(problem, best), settings, report)


def softness(u: Array, model: Elastic) -> Array:
    """A first guess of m: less the logarithm of the axial strain, smoothed, of elements."""
    strain = np.abs(gradient(resize(u[1], model.shape))[1])
    strain = blur(strain, 1.0)
    middle = float(np.median(strain))
    return -np.log(np.clip(strain / max(middle, TINY), 1 / STRONGEST, STRONGEST))
