"""Typed settings of the steps.

Every model is the settings argument of the function that uses it and, field by field, the options
of its command; most are sections of ``config/config.yaml`` as well. So a key has one name, one
check and one description everywhere.
"""

from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from eofm.errors import InputError
from eofm.grid import Edge

# Numbers beyond these have squares that are lost, or that nothing else can be added to.
LEAST, LARGEST = 1e-30, 1e30

# Pixels, and things, of which no image has more; and sides of a sample that is computed.
FAR, MOST, LONG = 1_000_000, 10_000_000, 20_000


def _not_lost(value: float) -> float:
    if value < LEAST:
        raise ValueError(f"wants at least {LEAST:g} (got {value:g})")
    return value


Positive = Annotated[float, Field(gt=0, le=LARGEST), AfterValidator(_not_lost)]


def _ascending(limits: tuple[float, float]) -> tuple[float, float]:
    if not limits[0] < limits[1]:
        raise ValueError(f"wants low < high (got {limits[0]:g}, {limits[1]:g})")
    if not LEAST <= limits[1] - limits[0] <= LARGEST:
        raise ValueError(f"are {limits[1] - limits[0]:g} apart; wants {LEAST:g} to {LARGEST:g}")
    return limits


def _spread(limits: tuple[float, float]) -> tuple[float, float]:
    if not 0 < limits[0] <= limits[1]:
        raise ValueError(f"wants 0 < low <= high (got {limits[0]:g}, {limits[1]:g})")
    return limits


# Letters of a wrong value that a message repeats.
LONGEST = 100

Range = tuple[float, float]
Limits = Annotated[Range, AfterValidator(_ascending)]
Spread = Annotated[Range, AfterValidator(_spread)]
FileName = Annotated[
    str, BeforeValidator(lambda name: str(name) if isinstance(name, Path) else name)
]
# First pixel and size of a part of an image, or of a volume, lateral first.
Region = tuple[int, int, int, int] | tuple[int, int, int, int, int, int]

# How the motion of an edge is said.
EDGE_WORDS = "free, fixed, moved U1 U2 [U3] [um], moved FILE, or outside"


class Section(BaseModel):
    """A group of settings; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    # Keys of windows in px, which an image limits.
    widths: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def takes_many(cls, name: str) -> bool:
        """Whether a key holds several values."""
        return "tuple" in str(cls.model_fields[name].annotation)

    @classmethod
    def parse(cls, values: dict[str, Any], where: str) -> Self:
        """Checked settings from plain values.

        Raises
        ------
        InputError
            In one line: the first value that is wrong, by name, and why.
        """
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            raise InputError(f"{where}: {_explain(error)}") from None

    def check_widths(self, shape: tuple[int, ...]) -> None:
        """Refuse windows that are wider than an image of a ``shape``.

        Raises
        ------
        InputError
            With the first key at fault.
        """
        for name in self.widths:
            width = getattr(self, name)
            if width is not None and width > max(shape):
                what = "image" if len(shape) == 2 else "volume"
                sides = " x ".join(str(n) for n in shape[::-1])
                raise InputError(f"{name}: {width:g} px is wider than the {what}, {sides} px")

    def changed(self, **values: Any) -> Self:
        """Return the same settings with other values of some keys, checked like all others."""
        return self.parse(dict(self) | values, type(self).__name__.lower())


def _explain(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    name = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        known = {key for section in Section.__subclasses__() for key in section.model_fields}
        close = get_close_matches(str(first["loc"][-1]), sorted(known), 1)
        return f"unknown key {name}; " + (f"did you mean {close[0]}?" if close else "misspelt?")
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "value_error":
        return f"{name}: {message}" if not isinstance(first["input"], dict) else message
    value = repr(first["input"])
    value = value if len(value) <= LONGEST else value[:LONGEST] + "..."
    got = "" if first["type"] == "missing" else f" (got {value})"
    return f"{name}: {message[0].lower()}{message[1:]}{got}"


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


class Tracking(Section):
    """Detection and matching of bubbles."""

    widths = ("smoothing", "window")

    smoothing: float = Field(0.7, ge=0, description="Gaussian applied before detection, px")
    threshold: float = Field(
        0.1, gt=0, lt=1, description="least brightness, as a part of the image's range"
    )
    min_area: int = Field(4, ge=1, le=FAR**2, description="least area above the threshold, px^2")
    max_area: int = Field(
        400, ge=1, le=FAR**2, description="largest area above the threshold, px^2"
    )
    gate: Positive = Field(2.5, description="largest distance from the predicted position, px")
    window: Positive = Field(2.0, description="Gaussian window of the sub-pixel registration, px")
    quality: float = Field(0.8, ge=-1, lt=1, description="least correlation of the two windows")
    neighbours: int = Field(8, ge=2, le=MOST, description="bubbles that a motion has to agree with")
    tolerance: Positive = Field(3.0, description="largest deviation from their median motion")


# Beyond these values of alpha one of the two terms is lost in rounding.
ALPHA = (1e-6, 1e9)

# The defaults of the method named "paper" where they differ from the preset's.
PAPER = {
    "smoothness": "gradient",
    "alpha": 0.8,
    "speckle_scales": "all",
    "gradients": "reference",
    "scales": 4,
    "warps": 1,
    "start": "zero",
    "warped_by": "nothing",
    "smoothness_of": "update",
    "ends": "half",
    "lengths": "scale",
    "denoising": 0.0,
    "robust": False,
}
# The reading of the multi-scale scheme that follows large motions, which the preset has.
WARPING: dict[str, Any] = {
    "warped_by": "u",
    "smoothness_of": "v",
    "ends": "full",
    "lengths": "finest",
}


class Estimation(Section):
    """The functional F, eq. (def_F), and the coarse-to-fine scheme."""

    widths = ("sigma", "local_window", "denoising")

    method: Literal["preset", "paper"] = Field(
        "preset",
        description="whose defaults the other keys have: the accurate preset's, or the paper's",
    )
    smoothness: Literal["gradient", "bending"] = Field(
        "bending", description="R: squared first (the paper's) or second derivatives"
    )
    alpha: Annotated[float, Field(ge=ALPHA[0], le=ALPHA[1])] | None = Field(
        None, description="weight of R; none: chosen on held-out pixels (with bending)"
    )
    beta: float = Field(0.5, ge=0, description="weight of the speckle term S")
    sigma: Positive = Field(5.0, description="width of the Gaussians g_sigma, px")
    speckle_scales: Literal["all", "coarse"] = Field(
        "coarse", description="scales with a speckle term: all, or all but the finest"
    )
    gradients: Literal["reference", "mean"] = Field(
        "mean", description="grad I: that of I1 (the paper's), or the mean with the warped I2's"
    )
    scales: int | None = Field(
        None,
        ge=1,
        le=1000,
        description="scales; 1 is the paper's 'no multi-scale'; none: as many as leave 12 px",
    )
    factor: float = Field(0.5, gt=0, lt=1, description="ratio of the sizes of two scales")
    warps: int = Field(2, ge=1, le=1000, description="linear solves per scale, each after a warp")
    start: Literal["zero", "background"] = Field(
        "background", description="field about which the images are linearised first"
    )
    warped_by: Literal["u", "v", "nothing"] = Field(
        "u",
        description="I2 is warped by the whole field, by what it adds to the background, or not",
    )
    smoothness_of: Literal["v", "update"] = Field(
        "v",
        description="R acts on all of v, or on what a scale adds: it takes the field of the scale"
        " before for u_bg",
    )
    ends: Literal["full", "half"] = Field(
        "full",
        description="the last of several scales: the pixels, or the next coarser one, from which"
        " u is interpolated",
    )
    lengths: Literal["finest", "scale"] = Field(
        "finest",
        description="whose px alpha, beta and sigma are measured in: the image's, or"
        " each scale's own",
    )
    zero_edges: tuple[Edge, ...] = Field(
        (), description="edges with v = 0: top and bottom are Gamma_1 and Gamma_2"
    )
    edge_weight: Positive | None = Field(
        None, description="weight of the penalty B on edges of known motion; none: exact there"
    )
    edge_bubbles: float = Field(
        1.0,
        ge=1,
        description="factor of beta for bubbles within 2 sigma of an edge of unknown motion",
    )
    limits: Limits | None = Field(
        None, description="intensities that become 0 and 1; none: extremes of both images"
    )
    local_window: Annotated[float, Field(ge=1)] | None = Field(
        None, description="window of the local normalisation of brightness and contrast, px"
    )
    denoising: float | None = Field(
        None,
        ge=0,
        description="Gaussian applied to the linearised images, px of each scale; none: up to 0.6,"
        " by the share of white noise in what is left of their difference",
    )

    robust: bool = Field(
        True,
        description="whether to fit changes of brightness and contrast, to weigh residuals by"
        " their noise, to leave out highlights, saturated lines and impulses, and to search far"
        " away",
    )

    @model_validator(mode="before")
    @classmethod
    def _defaults_of_the_method(cls, values: Any) -> Any:
        if isinstance(values, dict) and values.get("method") == "paper":
            return PAPER | values
        return values

    @model_validator(mode="after")
    def _can_choose_alpha(self) -> Self:
        if self.alpha is None and self.smoothness == "gradient":
            raise ValueError(
                "alpha: wants a value with the smoothness 'gradient'; only that of 'bending' is"
                " found well on held-out pixels"
            )
        return self

    @model_validator(mode="after")
    def _reading_makes_sense(self) -> Self:
        for key, value in WARPING.items():
            if self.smoothness == "bending" and getattr(self, key) != value:
                raise ValueError(
                    f"{key}: '{getattr(self, key)}' wants the smoothness 'gradient'; with"
                    f" 'bending' it is '{value}'"
                )
        if self.warped_by != "u" and self.start == "background":
            raise ValueError(
                "start: 'background' wants images that are warped by u (warped_by); use zero"
            )
        if self.warped_by == "nothing" and self.warps > 1:
            raise ValueError(
                f"warps: wants 1 where nothing is warped (got {self.warps}); or let u warp I2"
                " (warped_by)"
            )
        return self


class Identification(Section):
    """Settings of the identification."""

    cell: Positive | None = Field(
        None,
        description="side of the elements that carry E, px; none: 4, or more in large images",
    )
    gamma: Positive | None = Field(
        None, description="weight of the total variation; none: chosen on held-out bubbles"
    )
    gamma_range: Spread = Field((0.01, 30.0), description="weights tried, downwards")
    clear: float = Field(
        0.5, ge=0, description="standard errors that make a lower weight clearly better"
    )
    significant: float = Field(
        2.0, ge=0, description="the same, that make a contrast of the modulus significant"
    )
    worse: float = Field(
        1.0, ge=0, description="the same, by which the preset is better where E is refused"
    )
    clarity: float = Field(
        1.7,
        ge=0,
        description="contrast of log E relative to its error bars below which it is refused",
    )
    epsilon: Positive = Field(0.02, description="gradient of log E that counts as an edge, 1/px")
    iterations: int = Field(30, ge=1, le=1000, description="largest number of Gauss-Newton steps")
    least_gain: Positive = Field(5.0, description="gain in log-likelihood at which they stop")
    damping: Positive = Field(1.0, description="Levenberg's damping at the start")
    trust: float = Field(
        0.03,
        ge=0,
        description="relative contradiction of the edges' motion above which the images' is taken",
    )
    doubt: Positive = Field(
        0.2, description="the same, of an edge, above which the identification is refused"
    )
    rounds: int = Field(2, ge=1, le=1000, description="largest number of rounds of test 6")
    settled: Positive = Field(2e-3, description="relative change of u at which test 6 stops")


class Measures(Section):
    """What is made of a displacement."""

    strain_window: Positive | None = Field(
        None, description="Gaussian window of the strain's local linear fits, um; none: 3 px"
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
        description=f"{EDGE_WORDS}: px unless the word um follows; FILE is a table of u1, u2 in px,"
        " a row per pixel; outside (of the image, no condition) may be followed by what holds there"
        " for the elastic background",
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


class Tiling(Section):
    """How a volume is cut into parts that are estimated one by one."""

    tiles: Annotated[
        tuple[Annotated[int, Field(ge=1, le=1000)], ...], Field(min_length=3, max_length=3)
    ] = Field(
        description="number of tiles along the lateral, axial and elevational axis of a volume"
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
