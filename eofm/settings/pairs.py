"""Pairs of your own images, and what is made of them."""

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from eofm.settings.section import MOST, FileName, Positive, Section

# First pixel and size of a part of an image, or of a volume, lateral first.
Region = tuple[int, int, int, int] | tuple[int, int, int, int, int, int]

# How the motion of an edge is said.
EDGE_WORDS = (
    "free, fixed, moved U1 U2 [um] (of a volume U1 U2 U3; some may be free), moved FILE, or outside"
)


class Measures(Section):
    """What is made of a displacement."""

    strain_window: Positive | None = Field(
        None,
        description="standard deviation of the Gaussian window of the strain's local linear fits,"
        " um (px if no size of a pixel is known), the same along all axes, and so fewer px where"
        " pixels are longer; none: 3 times the geometric mean of their sides",
    )
    strain_measure: Literal["small", "green-lagrange", "almansi", "hencky"] = Field(
        "small", description="small strain, or a measure of large ones"
    )
    error_bars: int = Field(
        16, ge=0, le=10_000, description="samples for the standard deviations; 0 leaves them out"
    )
    stiffness: bool = Field(
        False,
        description="whether to identify the modulus; better if the image shows the whole sample",
    )


Side = Annotated[float, Field(ge=1e-6, le=1e9)]


class Scale(Section):
    """The sides of a pixel; what is left open is taken from the images' files."""

    lateral_size: Side | None = Field(
        None, description="width of a pixel, um; none: what the images' files say"
    )
    axial_size: Side | None = Field(None, description="height of a pixel, um; none: the same")
    elevational_size: Side | None = Field(
        None, description="distance of the slices of a volume, um; none: the same"
    )

    @property
    def sides(self) -> tuple[float | None, ...]:
        """Lateral, axial and elevational side of a pixel, um."""
        return self.lateral_size, self.axial_size, self.elevational_size


class Pair(Measures, Scale):
    """A pair of images, or a sequence, and what is known of the sample."""

    reference: FileName | None = Field(
        None,
        description="image or volume before compression: TIFF, NumPy, MATLAB, HDF5 and others;"
        " FILE#3 is page 3 of a stack, FILE#name a variable",
    )
    deformed: FileName | None = Field(None, description="image or volume after compression")
    frames: FileName | None = Field(
        None, description="instead of both: a stack of frames; edges move by this much in each step"
    )
    intensity: Literal["linear", "log"] = Field(
        "linear", description="use the values as they are, or their logarithm"
    )
    roi: Region | None = Field(
        None,
        description="region of interest: x1, x2, width and height, px (of all slices of a volume),"
        " or x1, x2, x3, width, height and depth; none: all",
    )
    mask: FileName | None = Field(
        None,
        description="dead zones without data: an image or volume that is not 0 there, or the"
        " corners of a polygon, 'x1,x2 x1,x2 x1,x2', px of the whole image or of all slices",
    )
    top: str = Field(
        "free",
        description=f"{EDGE_WORDS}: px unless the word um follows; 'moved free -3' is a plate along"
        " which the sample slides; FILE is a table of u1, u2 in px, a row per pixel; outside (of"
        " the image, no condition) may be followed by what holds there for the elastic background",
    )
    bottom: str = Field("free", description="the same")
    left: str = Field("free", description="the same")
    right: str = Field("free", description="the same")
    front: str = Field("free", description="the same, of a volume's first slice")
    back: str = Field("free", description="the same, of its last slice")
    background: str = Field(
        "none", description="none, elastic (of a homogeneous sample), or a field in px (TIFF)"
    )
    extent: Region | None = Field(
        None, description="the whole sample in px of the image, may reach beyond it; none: the roi"
    )
    poisson_ratio: float = Field(0.49, gt=0, lt=0.5, description="of the elastic background")
    plane: Literal["strain", "stress"] = Field("strain", description="of the elastic background")
    figures: Literal["none", "png", "all"] = Field(
        "png", description="figures to draw: none, PNG, or all (PNG and PDF)"
    )

    @property
    def files(self) -> list[str]:
        """Names of the images."""
        return [name for name in (self.frames, self.reference, self.deformed) if name]

    @model_validator(mode="after")
    def _has_images(self) -> Self:
        if (self.reference is None) != (self.deformed is None):
            raise ValueError("reference and deformed: give both, or frames instead")
        if (self.reference is None) == (self.frames is None):
            raise ValueError("reference: wants reference and deformed, or frames, not both")
        sides = self.roi[len(self.roi) // 2 :] if self.roi else (8,)
        if min(sides) < 8:
            said, least = (" x ".join(map(str, n)) for n in (sides, [8] * len(sides)))
            raise ValueError(f"roi: is {said} px; wants at least {least} px")
        return self


def _three(tiles: tuple[int, ...]) -> tuple[int, ...]:
    if len(tiles) != 3:
        raise ValueError(f"wants three numbers, not {len(tiles)}: volumes alone are cut into tiles")
    return tiles


class Tiling(Section):
    """How a volume is cut into parts that are estimated one by one."""

    tiles: Annotated[tuple[Annotated[int, Field(ge=1, le=1000)], ...], AfterValidator(_three)] = (
        Field(
            description="number of tiles along the lateral, axial and elevational axis of a volume"
        )
    )
    overlap: int = Field(
        16,
        ge=4,
        le=1000,
        description="how far tiles reach into each other, px; several times the length over which"
        " the field is smoothed, which the log says",
    )

    @classmethod
    def count(cls, text: str) -> tuple[int, ...]:
        """Numbers of tiles from a text such as '4 4 2', elevational first, as arrays are.

        Raises
        ------
        InputError
            If it says something else.
        """
        words: list[Any] = [int(word) if word.isdecimal() else word for word in text.split()]
        return cls.parse({"tiles": words}, "tiling").tiles[::-1]


class PartOfScale(Section):
    """Which tile of which scale."""

    level: int = Field(0, ge=0, le=30, description="how many scales coarser than the volume's own")
    number: int = Field(0, ge=0, le=MOST, description="number of the tile, from 0")


class Figures(Section):
    """How the figures look."""

    pixel_size: tuple[Positive, ...] = Field(
        (5.0, 5.0),
        min_length=2,
        max_length=3,
        description="lateral, axial (and elevational) side of a pixel, um",
    )
    unit: Literal["um", "px"] = Field("um", description="of positions and displacements")
    levels: int = Field(12, ge=2, le=50, description="number of level lines in a panel")
    dpi: int = Field(200, ge=50, le=1200, description="resolution of the PNG files, dots per inch")

    def sides(self, ndim: int) -> tuple[float, ...]:
        """Sides of a pixel of an image, or of a voxel, um; as deep as it is wide by default."""
        return (*self.pixel_size, self.pixel_size[0])[:ndim]
