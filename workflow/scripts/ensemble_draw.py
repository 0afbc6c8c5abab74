"""Random phantoms: what sample, which images. Drawn by seeds alone, before anything is measured.

Odd numbers are for tuning, even ones are reported.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import eofm
from eofm.app.config import Config, Ensemble
from eofm.elasticity.forward import lame
from eofm.imaging.intensity import normalise

Array = NDArray[np.float64]

# Of dense speckle: how its bubbles look, and how many there are per px.
SPECKLE = {"sigma": (1.2, 1.8), "brightness": (0.3, 1.0), "noise": 0.0}
DENSITY = 0.08
# Of other images as the renderer has them.
LOOKS: dict[str, dict[str, Any]] = {
    "bubbles": {},
    "brightest": {"overlap": "brightest"},
    "strained": {"strained": True},
    "speckle": SPECKLE,
}
# How much larger than its image a sample is of which a part is cut out.
LARGER = 1.5
ATTEMPTS = 1000


class Draw(NamedTuple):
    """What a phantom is.

    Attributes
    ----------
    sample : Sample
    region : tuple of slice
        The part of the sample that the images show.
    renderer : str
    noise, brightness : float
        As parts of the images' range.
    """

    sample: eofm.Sample
    region: tuple[slice, slice]
    renderer: str
    noise: float
    brightness: float

    @property
    def cut(self) -> bool:
        """Whether the sample goes on beyond the images."""
        return self.region[0].stop - self.region[0].start < self.sample.height

    @property
    def shown(self) -> eofm.Sample:
        """The part that the images show, without inclusions: those are what is sought."""
        height, width = (s.stop - s.start for s in self.region)
        size = {"height": height, "width": width, "inclusions": ()}
        return self.sample.model_copy(update=size)

    @property
    def modulus(self) -> Array:
        """True modulus relative to the background's, of the region's shape."""
        x = np.mgrid[self.region][::-1].astype(float)
        plain = self.sample.model_copy(update={"inclusions": ()})
        return lame(self.sample, x)[1] / lame(plain, x)[1]


def draw(settings: Ensemble, sample: eofm.Sample, number: int) -> Draw:
    """Phantom ``number``, from 1, of an ensemble; ``sample`` says how large its images are."""
    order = np.random.default_rng([settings.seed, 0])

    def deal(cards: tuple[Any, ...]) -> Any:
        return cards[order.permutation(settings.count)[number - 1] % len(cards)]

    renderer, noise, count = map(deal, (settings.renderers, settings.noise, settings.inclusions))
    cut, brightness = map(deal, (settings.cut, settings.brightness))
    rng = np.random.default_rng([settings.seed, number])
    size = [round(LARGER * n) if cut else n for n in sample.shape]
    first = [int(rng.integers(n - k + 1)) for n, k in zip(size, sample.shape, strict=True)]
    inclusions = tuple(
        part.model_copy(update={"x1": part.x1 + first[1], "x2": part.x2 + first[0]})
        for part in place(settings, sample, count, rng)
    )
    changes = {
        "height": size[0],
        "width": size[1],
        "poisson_ratio": settings.poisson_ratio,
        "compression": size[0] * rng.uniform(*settings.compression),
        "inclusions": inclusions,
    }
    rows, columns = (slice(a, a + k) for a, k in zip(first, sample.shape, strict=True))
    return Draw(sample.model_copy(update=changes), (rows, columns), renderer, noise, brightness)


def place(
    settings: Ensemble, sample: eofm.Sample, count: int, rng: np.random.Generator
) -> tuple[eofm.Inclusion, ...]:
    """Discs and ellipses that touch neither each other nor the image's edges."""
    last = np.reshape(sample.shape[::-1], (2, 1)) - 1.0
    for _ in range(ATTEMPTS):
        radius = sample.height * rng.uniform(*settings.radius, count)
        aspect = np.exp(rng.uniform(*np.log(settings.aspect), count))
        aspect[rng.random(count) < 0.5] = 1.0
        radii = radius * np.stack([np.sqrt(aspect), 1 / np.sqrt(aspect)])
        if (radii + 1 >= last / 2).any():
            continue
        x = rng.uniform(radii + 1, last - radii - 1)
        apart = [
            np.hypot(*(x[:, i] - x[:, j])) > radii[:, i].max() + radii[:, j].max() + 1
            for i in range(count)
            for j in range(i)
        ]
        if all(apart):
            E = np.exp(rng.uniform(*np.log(settings.stiffness), count))
            columns = zip(*x, radius, aspect, E, strict=True)
            return tuple(
                eofm.Inclusion(x1=x1, x2=x2, radius=r, aspect=q, stiffness=e)
                for x1, x2, r, q, e in columns
            )
    raise eofm.InputError("ensemble: inclusions do not fit into the sample; lower the radius")


def render(u: Array, phantom: Draw, config: Config, seed: int) -> tuple[Array, Array]:
    """Images of a sample with a true displacement, in [0, 1], shape of the region each."""
    if phantom.renderer == "oct":
        # The enlarged sample of that experiment has as many reflectors in four times the area.
        changes = {"scale": 1.0, "margin": (0.0, 0.0), "seed": seed}
        changes["reflectors"] = round(u[0].size / 20)
        oct_ = config.virtual_oct.model_copy(update=changes)
        whole = eofm.make_tomograms(u, np.zeros_like(u), oct_)[:2]
    else:
        look = LOOKS[phantom.renderer] | {"seed": seed}
        dense = DENSITY if phantom.renderer == "speckle" else None
        bubbles = config.phantom.count / (config.sample.height * config.sample.width)
        look["count"] = round((dense or bubbles) * u[0].size)
        whole = eofm.make_phantom(u, config.phantom.model_copy(update=look))[:2]
    images = np.stack([I[phantom.region] for I in whole])
    rng = np.random.default_rng([seed, 3])
    images[1] *= 1 + phantom.brightness * _ramp(images.shape[1:], rng)
    noise = phantom.noise * np.ptp(images) * rng.normal(size=images.shape)
    return normalise(*(images + noise))


def _ramp(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """A plane in a random direction whose largest absolute value is 1."""
    x2, x1 = (np.linspace(-1, 1, n) for n in shape)
    a, b, c = rng.uniform(-1, 1, 3)
    return (a * x1 + b * x2[:, None] + c) / (abs(a) + abs(b) + abs(c))
