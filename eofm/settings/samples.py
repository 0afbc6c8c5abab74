"""Samples whose truth is known, and their images."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from eofm.settings.section import FAR, LEAST, LONG, MOST, Limits, Positive, Range, Section, Spread


class Inclusion(Section):
    """An inclusion: a disc or an ellipse along the axes, in a volume a sphere or an ellipsoid."""

    x1: float = Field(ge=-FAR, le=FAR, description="lateral position of the centre, px")
    x2: float = Field(ge=-FAR, le=FAR, description="axial position of the centre (down), px")
    x3: Annotated[float, Field(ge=-FAR, le=FAR)] | None = Field(
        None, description="elevational position of the centre, px; of a volume alone"
    )
    radius: Positive = Field(description="radius, of an ellipse the mean of its logarithms, px")
    aspect: Positive = Field(1.0, description="lateral over axial radius; 1 is a disc")
    stiffness: Positive = Field(description="Young's modulus relative to the background")


# Sides of a sample of which one is so many times another are beyond the forward model's meshes.
SLENDER = {2: 500, 3: 100}


class Sample(Section):
    """The sample and how it is pressed."""

    height: int = Field(
        ge=8, le=LONG, description="rows of the image, which shows the whole sample, px"
    )
    width: int = Field(ge=8, le=LONG, description="columns of the image, px")
    depth: Annotated[int, Field(ge=8, le=LONG)] | None = Field(
        None, description="slices of the volume, px; none: an image"
    )
    poisson_ratio: float = Field(0.49, gt=0, lt=0.5, description="Poisson ratio of all materials")
    plane: Literal["strain", "stress"] = Field(
        "strain", description="plane strain or plane stress, of an image"
    )
    inclusions: tuple[Inclusion, ...] = Field((), description="what differs from the background")
    compression: float = Field(3.0, description="upward motion of the bottom, px")
    contact: Literal["clamped", "slip"] = Field(
        "clamped", description="whether top and bottom are held sideways or slide"
    )

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns, of a volume slices first."""
        image = self.height, self.width
        return image if self.depth is None else (self.depth, *image)

    @model_validator(mode="after")
    def _compression_fits(self) -> Self:
        if 0 < abs(self.compression) < LEAST:
            raise ValueError(f"compression: wants 0, or at least {LEAST:g} px")
        if abs(self.compression) >= self.height / 2:
            raise ValueError(
                f"compression: {self.compression:g} px is half of the sample's height"
                f" ({self.height} px) or more; linear elasticity does not hold there"
            )
        return self

    @model_validator(mode="after")
    def _is_no_thread(self) -> Self:
        most = SLENDER[len(self.shape)]
        if max(self.shape) > most * min(self.shape):
            sides = " x ".join(str(n) for n in self.shape[::-1])
            raise ValueError(f"{sides} px: no side may be more than {most} times another")
        return self

    @model_validator(mode="after")
    def _dimensions_agree(self) -> Self:
        if self.depth is not None and self.plane == "stress":
            raise ValueError("plane: a volume has no plane stress; leave it out")
        for k, part in enumerate(self.inclusions):
            if (part.x3 is None) != (self.depth is None):
                wants = "no x3" if self.depth is None else "x3, as the sample has a depth"
                raise ValueError(f"inclusions: number {k + 1} wants {wants}")
        return self


class Forward(Section):
    """Accuracy of the forward model."""

    true_cell: Positive | None = Field(
        None, description="side of the elements for the true field, px; none: 1, of a volume 3"
    )
    background_error: Positive = Field(
        1e-3, description="largest estimated error of the background field, px"
    )


class Phantom(Section):
    """The scattering images of the simulated sample."""

    count: int = Field(200, ge=1, le=MOST, description="number of bubbles")
    sigma: Spread = Field((1.23, 1.23), description="range of their standard deviations, px")
    brightness: Spread = Field((0.15, 0.22), description="range of their peak intensities")
    distance: float = Field(0.0, ge=0, description="least distance of two bubbles, px")
    base: float = Field(0.0, ge=0, le=1, description="intensity between the bubbles")
    overlap: Literal["sum", "brightest"] = Field(
        "sum", description="what a pixel shows of several bubbles"
    )
    strained: bool = Field(
        False, description="whether bubbles are strained with the sample, or keep their shape"
    )
    noise: float = Field(
        0.0, ge=0, description="standard deviation of the noise, relative to the brightest bubble"
    )
    seed: int = Field(1, ge=0, description="seed of positions, sizes, brightness and noise")


# Level of a reflector, dB: ten times what no instrument tells apart any more.
LOUDEST = 1000


class VirtualOct(Section):
    """The virtual OCT experiment: scatterers of the enlarged sample, a microscope, a region."""

    scale: float = Field(
        2.0, ge=1, le=10, description="enlargement of the sample, its compression included"
    )
    margin: Range = Field(
        (0.05, 0.05), description="part cut away on either side, laterally and axially"
    )
    pixel_size: Positive = Field(5.0, description="side of a pixel, um")
    wavelength: Positive = Field(1.3, description="centre wavelength in vacuum, um")
    refractive_index: float = Field(1.4, ge=1, description="refractive index of the sample")
    lateral_resolution: Positive = Field(
        10.0, description="full width at half maximum of a point's intensity, um"
    )
    axial_resolution: Positive = Field(7.0, description="the same in depth, inside the sample, um")
    density: Positive = Field(
        10.0, description="weak scatterers of the matrix in the area pi w1 w2 of an echo"
    )
    reflectors: int = Field(
        1500, ge=0, le=MOST, description="number of strong reflectors in the sample"
    )
    reflector_level: Range = Field(
        (20.0, 30.0), description="range of their intensities, dB above the matrix's mean"
    )
    attenuation: float = Field(1.0, ge=0, description="attenuation coefficient, 1/mm")
    noise: float = Field(
        0.3, ge=0, description="intensity of the shot noise, relative to the matrix's mean"
    )
    display: Limits = Field(
        (0.0, 30.0), description="intensities that become 0 and 1, dB above the matrix's mean"
    )
    seed: int = Field(1, ge=0, description="seed of the scatterers and the noise")

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        if not all(0 <= m < 0.5 for m in self.margin):
            raise ValueError(
                f"margin: wants two values of at least 0 and below 0.5 (got {self.margin[0]:g},"
                f" {self.margin[1]:g})"
            )
        low, high = self.reflector_level
        if not -LOUDEST <= low <= high <= LOUDEST:
            raise ValueError(
                f"reflector_level: wants low <= high, of at most {LOUDEST} dB (got {low:g},"
                f" {high:g})"
            )
        return self
