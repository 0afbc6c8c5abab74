"""The configuration of the workflow, ``config/config.yaml``: settings of the steps, and its own."""

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from eofm.io import read_settings
from eofm.settings import (
    Estimation,
    Figures,
    Forward,
    Identification,
    Inclusion,
    Phantom,
    Positive,
    Sample,
    Section,
    Spread,
    Tracking,
    VirtualOct,
)

# Rows that are no variants of the paper's test.
RESERVED = ("background", "5b", "6")

Tool = Literal[
    "eofm", "eofm_preset", "tvl1", "ilk", "dis", "deepflow", "elastix", "demons", "pyxel"
]


class Benchmark(Section):
    """Time, memory and error of several tools and of the solver, by size."""

    sizes: tuple[Annotated[int, Field(ge=48)], ...] = Field(
        (256, 512, 1024, 2048), description="sides of the square images, px"
    )
    largest: dict[Tool, int] = Field(
        {
            "eofm": 2048,
            "eofm_preset": 2048,
            "tvl1": 1024,
            "ilk": 2048,
            "dis": 2048,
            "deepflow": 2048,
            "elastix": 1024,
            "demons": 1024,
            "pyxel": 2048,
        },
        description="the tools, and the largest size for which each is run, px",
    )
    alphas: tuple[Positive, ...] = Field(
        (0.01, 0.1, 1.0, 10.0, 100.0), description="weights of the smoothness term in the solver"
    )
    seed: int = Field(1, ge=0, description="seed of the images")


VolumeTool = Literal["eofm", "eofm_preset", "tvl1", "ilk", "elastix", "demons", "aldvc"]


class BenchmarkVolume(Section):
    """The same of volumes, and the cases of al-dvc."""

    sizes: tuple[Annotated[int, Field(ge=24)], ...] = Field(
        (64, 128, 256), description="sides of the cubes, voxels"
    )
    largest: dict[VolumeTool, int] = Field(
        {
            "eofm": 256,
            "eofm_preset": 256,
            "tvl1": 128,
            "ilk": 128,
            "elastix": 128,
            "demons": 128,
            "aldvc": 128,
        },
        description="the tools, and the largest size for which each is run; beyond 128 voxels on"
        " two threads",
    )
    cases: int = Field(
        128, ge=48, description="longest side of the volumes with al-dvc's motions, voxels"
    )
    seed: int = Field(1, ge=0, description="seed of the volumes")


Renderer = Literal["bubbles", "brightest", "strained", "speckle", "oct"]


class Robustness(Section):
    """Pairs whose brightness, noise or speckle changes, and large motions."""

    frames: tuple[str, ...] = Field((), description="real images that are moved, beside rendered")
    size: int = Field(256, ge=48, description="sides of the images, px")
    motion: Positive = Field(5.0, description="displacement at the bottom, px")
    tools: tuple[str, ...] = Field(
        ("dis", "deepflow", "ilk", "elastix"), description="other tools that see the same pairs"
    )
    seed: int = Field(11, ge=0, description="seed of the half for tuning; the other has the next")


class Volume(Section):
    """A pressed box with a sphere, as bubbles and as dense speckle, and its estimates."""

    sample: Sample = Field(
        Sample(
            height=80,
            width=96,
            depth=64,
            compression=2.6,
            inclusions=(Inclusion(x1=56.0, x2=50.0, x3=30.0, radius=18.0, stiffness=7.5),),
        ),
        description="size, sphere and load",
    )
    bubbles: Phantom = Field(
        Phantom(count=500), description="images of bubbles as far apart as the paper's"
    )
    speckle: Phantom = Field(
        Phantom(count=11_000, sigma=(1.2, 1.8), brightness=(0.3, 1.0), noise=0.05),
        description="images of dense speckle",
    )


class Ensemble(Section):
    """Random phantoms on which all methods and tools are compared.

    Choices are dealt like cards: each list goes round until every phantom has one of it, in
    random order.
    """

    count: int = Field(40, ge=1, description="number of phantoms; odd ones are for tuning")
    renderers: tuple[Renderer, ...] = Field(
        ("bubbles", "brightest", "strained", "speckle", "oct"),
        min_length=1,
        description="how images are made, dealt: bubbles that add up, the brightest of them,"
        " bubbles strained with the sample, dense speckle, virtual OCT",
    )
    noise: tuple[Annotated[float, Field(ge=0)], ...] = Field(
        (0.0, 0.01, 0.02, 0.05, 0.1),
        min_length=1,
        description="white noise as a part of the images' range, dealt",
    )
    inclusions: tuple[Annotated[int, Field(ge=0, le=3)], ...] = Field(
        (0, 1, 1, 1, 1, 2, 2, 3), min_length=1, description="numbers of inclusions, dealt"
    )
    cut: tuple[bool, ...] = Field(
        (False, False, False, True),
        min_length=1,
        description="whether the image is cut out of a sample half as large again, dealt",
    )
    brightness: tuple[Annotated[float, Field(ge=0, lt=1)], ...] = Field(
        (0.0, 0.0, 0.3),
        min_length=1,
        description="largest change of brightness between the images, a gain that varies along a"
        " line, dealt",
    )
    radius: Spread = Field((0.12, 0.3), description="range of the radii, relative to the height")
    aspect: Spread = Field((0.5, 2.0), description="range of the aspect of half the inclusions")
    stiffness: Spread = Field((0.1, 12.0), description="range of the moduli, log-uniform")
    compression: Spread = Field(
        (0.028, 0.037), description="range of the bottom's motion, relative to the height"
    )
    poisson_ratio: float = Field(0.49, gt=0, lt=0.5, description="Poisson ratio of all materials")
    seed: int = Field(2026, ge=0, description="seed of samples and images")


class Studies(Section):
    """How much of the studies is run."""

    folder: str = Field("config/studies", description="tables of what is varied (YAML)")
    values: int | None = Field(
        None, ge=1, description="largest number of values along each axis; none: all"
    )
    cases: int | None = Field(
        None, ge=1, description="largest number of cases of each study; none: all"
    )
    searches: int = Field(3, ge=1, le=100, description="searches for the phantom, from anywhere")
    evaluations: int = Field(
        100, ge=10, le=1_000_000, description="phantoms that each of them tries, about"
    )


class Variant(Section):
    """One row of Table 1: what it changes in the estimation."""

    background: bool = Field(True, description="whether the background field is used")
    changes: dict[str, Any] = Field({}, description="settings that differ from the estimation's")

    @model_validator(mode="after")
    def _keeps_the_method(self) -> Self:
        if "method" in self.changes:
            raise ValueError("changes: the method has no effect here; name what it would change")
        return self


class Config(Section):
    """The whole experiment."""

    sample: Sample
    forward: Forward = Forward()
    phantom: Phantom = Phantom()
    virtual_oct: VirtualOct = VirtualOct()
    tracking: Tracking = Tracking()
    estimation: Estimation = Estimation(method="paper")
    tests: dict[str, Variant] = Field({})
    figures: Figures = Figures()
    preset: Estimation = Estimation()
    identification: Identification = Identification()
    benchmark: Benchmark = Benchmark()
    benchmark_volume: BenchmarkVolume = BenchmarkVolume()
    ensemble: Ensemble = Ensemble()
    robustness: Robustness = Robustness()
    volume: Volume = Volume()
    studies: Studies = Studies()
    samples: str = Field("config/samples.tsv", description="table of your own image pairs (TSV)")
    container: str = Field(
        "eofm.sif", description="image for rules that run in containers, see profiles/README.md"
    )

    def variant(self, name: str) -> Estimation:
        """Settings of one row of Table 1."""
        values = self.estimation.model_dump() | self.tests[name].changes
        return Estimation.parse(values, f"tests.{name}.changes")

    @model_validator(mode="after")
    def _tests_are_valid(self) -> Self:
        for name in self.tests:
            if name in RESERVED or not re.fullmatch(r"[\w-]+", name):
                raise ValueError(
                    f"tests: '{name}' cannot be a test's name; use letters, digits, - and _, and"
                    f" none of {', '.join(RESERVED)}"
                )
            self.variant(name)
        return self


def load(path: Path) -> Config:
    """Read and check a configuration file.

    Raises
    ------
    InputError
        If the file is missing, is not YAML, or a key or value is wrong.
    """
    return Config.parse(read_settings(path), str(path))
