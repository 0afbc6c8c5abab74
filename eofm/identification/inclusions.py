"""A modulus that is constant but for inclusions with smooth outlines: few numbers to be sought.

An outline is ``log r = a_0 + sum_k a_k cos k t + b_k sin k t`` about its middle, with the angle t,
``k`` from 2. Where the images are noisy, that is known much better than the modulus of each
element: a prior of total variation takes off contrast and spreads outlines over the noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

from eofm.elasticity.sensitivity import Elastic, State
from eofm.grid import Array
from eofm.identification.inversion import Inversion, Report
from eofm.settings import Identification

# Sides of an element per width over which an outline is spread: about what an element averages.
WIDTH = 6
# Radius and distance of the discs that may become inclusions, as a part of the root of the area.
DISC = 0.1
# Steps after which the best of several is told.
BRIEF = 8
# Harmonics of an outline, and their standard deviations before the images are seen; an ellipse
# whose axes are as 2 to 1 has 0.33 of the second and 0.06 of the fourth.
HARMONICS = np.arange(2, 7)
SPREADS = 0.5 * HARMONICS**-2.5
# Standard deviation of m; of places and radii, which the images must say, no one is known.
CONTRAST = 2.0
# Middle (2), log radius, m, and the cosines and sines of an inclusion.
SIZE = 4 + 2 * len(HARMONICS)
FIRST_SINE = 4 + len(HARMONICS)
PRIOR = np.r_[np.zeros(3), CONTRAST**-2.0, np.tile(SPREADS**-2.0, 2)]
# Second harmonic of an outline that may be of two inclusions.
LONG = 0.5
# Part of the least gain at which fits of so few numbers stop: they creep along valleys.
FEW = 0.02
# Changes of z that go together through the mesh.
TOGETHER = 16
# Largest change of m and of a log radius in one step.
STEP = 0.7


@dataclass(frozen=True)
class Inclusions:
    """Inclusions on elements.

    Attributes
    ----------
    model : Elastic
    p : ndarray, shape (count, SIZE)
    """

    model: Elastic
    p: Array

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.p)

    @property
    def parts(self) -> list[tuple[Array, Array]]:
        """The m of each, and its derivative, shapes (elements,), (SIZE, elements)."""
        h1, h2 = self.model.sides
        width = (h1 + h2) / WIDTH
        k = HARMONICS[:, None]
        x2, x1 = ((np.arange(n) + 0.5) * h for n, h in zip(self.model.shape, (h2, h1), strict=True))
        grid = [f.ravel() for f in np.broadcast_arrays(x1, x2[:, None])]
        parts = []
        for c1, c2, size, contrast, *waves in self.p:
            d1, d2 = grid[0] - c1, grid[1] - c2
            rho, t = np.hypot(d1, d2) + 1e-9, np.arctan2(d2, d1)
            a, b = np.reshape(waves, (2, -1, 1))
            cos, sin = np.cos(k * t), np.sin(k * t)
            r = np.exp(np.minimum(size + (a * cos + b * sin).sum(0), 20))
            turn = r * (k * (b * cos - a * sin)).sum(0) / rho**2
            share = 0.5 * (1 + np.tanh((r - rho) / width))
            slope = contrast * 2 * share * (1 - share) / width
            rows = [d1 / rho + turn * d2, d2 / rho - turn * d1, r, *(r * cos), *(r * sin)]
            by = slope * np.stack(rows)
            parts.append((contrast * share, np.insert(by, 3, share, axis=0)))
        return parts

    def cut(self) -> "Inclusions":
        """The same with two discs in the place of the longest one."""
        waves = self.p[:, [4, FIRST_SINE]]
        k = int(np.hypot(*waves.T).argmax())
        x, length = self.p[k, :2], np.exp(self.p[k, 2] + np.hypot(*waves[k])) / 2
        angle = np.arctan2(*waves[k, ::-1]) / 2
        apart = length * np.array([np.cos(angle), np.sin(angle)])
        rest = np.r_[np.log(length), self.p[k, 3], np.zeros(SIZE - 4)]
        discs = [np.r_[x + side * apart, rest] for side in (-1, 1)]
        return replace(self, p=np.vstack([np.delete(self.p, k, axis=0), discs]))

    def on(self, problem: Inversion) -> "Outlined":
        """The same in an inversion on other elements, whose edges move as first guessed."""
        return replace(self, model=problem.model).outlined(problem, problem.start())

    def outlined(self, problem: Inversion, z: Array) -> "Outlined":
        """The same in an inversion, whose edges move as ``z`` says."""
        parts, elements = self.parts, problem.elements
        m = sum((part for part, _ in parts), np.zeros(elements))
        by = np.concatenate([d for _, d in parts] or [np.zeros((0, elements))])
        return Outlined(self, problem, np.r_[m, z[elements:]], by)


@dataclass(frozen=True)
class Outlined:
    """Inclusions and motion of edges in an inversion.

    Attributes
    ----------
    inclusions : Inclusions
    problem : Inversion
    z : ndarray
        See :class:`Inversion`.
    by : ndarray, shape (numbers of the inclusions, elements)
        Derivative of m.
    """

    inclusions: Inclusions
    problem: Inversion
    z: Array
    by: Array

    @property
    def prior(self) -> Array:
        """Inverse variances of the numbers before the images are seen."""
        return np.r_[np.tile(PRIOR, self.inclusions.count), np.ones(self.edges)]

    @property
    def edges(self) -> int:
        """Unknowns of the edges."""
        return self.problem.edges.shape[1]

    @property
    def values(self) -> Array:
        """All numbers that are sought."""
        return np.r_[self.inclusions.p.ravel(), self.z[self.problem.elements :]]

    def changed(self, d: Array) -> "Outlined":
        """The same after a change of the numbers."""
        p = self.inclusions.p
        moved = replace(self.inclusions, p=p + d[: p.size].reshape(p.shape))
        z = self.z.copy()
        z[self.problem.elements :] += d[p.size :]
        return moved.outlined(self.problem, z)

    @property
    def changes(self) -> Array:
        """Change of ``z`` with each of the numbers."""
        return block_diag(self.by, np.eye(self.edges))

    def more(self, places: int) -> list["Outlined"]:
        """The same with one more inclusion, in ways that promise to take most off the misfit.

        A very long one, which may be two, is cut; if there is none, a disc is added at each of some
        places where it does so to first order, not close to each other.
        """
        problem, p = self.problem, self.inclusions.p
        if len(p) and np.hypot(p[:, 4], p[:, FIRST_SINE]).max() > LONG:
            return [self.inclusions.cut().outlined(problem, self.z)]
        state = problem.state(self.z)
        right = problem.back(self.z, state, problem.misfit(state))
        shape, sides = problem.model.shape[::-1], problem.model.sides
        lengths = [k * h for k, h in zip(shape, sides, strict=True)]
        radius = DISC * np.sqrt(lengths[0] * lengths[1])
        x = [np.arange(radius / 2, length, radius) for length in lengths]
        middles = np.stack(np.meshgrid(*x), axis=-1).reshape(-1, 2)
        discs = np.zeros((len(middles), SIZE))
        discs[:, :2], discs[:, 2], discs[:, 3] = middles, np.log(radius), 1.0
        d = np.stack([m for m, _ in replace(self.inclusions, p=discs).parts])
        d = np.pad(d, [(0, 0), (0, self.edges)])
        slopes, curvatures = d @ right, (self._seen(state, d) ** 2).sum(1) + CONTRAST**-2
        discs[:, 3] = np.clip(slopes / curvatures, -STEP, STEP)
        kept: list[Array] = []
        for disc in discs[np.argsort(-(slopes**2) / curvatures, kind="stable")]:
            apart = (np.hypot(*(disc[:2] - other[:2])) > 1.5 * radius for other in kept)
            if len(kept) < places and all(apart):
                kept.append(disc)
        more = (replace(self.inclusions, p=np.vstack([p, disc])) for disc in kept)
        return [inclusions.outlined(problem, self.z) for inclusions in more]

    def derivative(self, state: State) -> Array:
        """Of what is left of the images by each number, shape (numbers, pixels)."""
        return self._seen(state, self.changes)

    def _seen(self, state: State, d: Array) -> Array:
        """Changes of what is left of the images for changes of ``z``, shape (len(d), pixels)."""
        problem = self.problem
        seen = np.empty((len(d), problem.r.size))
        for first in range(0, len(d), TOGETHER):
            some = slice(first, first + TOGETHER)
            u = problem.forth(self.z, state, d[some])
            seen[some] = problem.seen(u).reshape(len(u), -1)
        return seen

    def cost(self, state: State) -> float:
        """Value of the functional."""
        fit = (self.problem.left(state) ** 2).sum()
        return float(fit + (self.prior * self.values**2).sum())


def no_inclusions(problem: Inversion, z: Array) -> Outlined:
    """A homogeneous sample, whose edges move as ``z`` says."""
    return Inclusions(problem.model, np.zeros((0, SIZE))).outlined(problem, z)


def one_more(now: Outlined, places: int, settings: Identification, report: Report) -> Outlined:
    """Inclusions that fit the images best, one more than some, tried at so many places."""
    tried = now.more(places)
    if len(tried) > 1:
        brief = settings.changed(iterations=min(BRIEF, settings.iterations))
        tried = [outline(start, brief, report) for start in tried]
    best = min(tried, key=lambda found: found.cost(found.problem.state(found.z)))
    return outline(best, settings, report)


def outline(now: Outlined, settings: Identification, report: Report) -> Outlined:
    """Inclusions that fit the images best, started from some, by Levenberg and Marquardt."""
    if not now.prior.size:
        return now
    problem = now.problem
    state = problem.state(now.z)
    cost, damping = now.cost(state), 1e-2
    system = None
    for step in range(settings.iterations):
        if system is None:
            G = now.derivative(state)
            H = G @ G.T + np.diag(now.prior)
            right = -G @ problem.left(state).ravel() - now.prior * now.values
            system = H, right
        H, right = system
        damped = H + np.diag(damping * np.diag(H) + 1e-9 * np.diag(H).max())
        d = cho_solve(cho_factor(damped), right)
        jumps = np.abs(d[: now.inclusions.p.size].reshape(-1, SIZE)[:, 2:])
        d *= min(1.0, STEP / max(float(jumps.max(initial=0)), 1e-12))
        trial = now.changed(d)
        trial_state = problem.state(trial.z)
        gain = cost - trial.cost(trial_state)
        report(0.0, step + 1, gain)
        if not gain > 0:
            damping *= 8
            if damping > 1e6:
                break
            continue
        now, state, cost, damping, system = trial, trial_state, cost - gain, damping / 4, None
        if gain < FEW * settings.least_gain:
            break
    return now
