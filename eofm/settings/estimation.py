"""The tracker, the flow and the identification."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from eofm.grid import Edge
from eofm.settings.section import FAR, MOST, Limits, Positive, Section, Spread


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
        " by the share of white noise in what is left of their difference, and 2 where fine"
        " structures stand still while the sample moves",
    )

    robust: bool = Field(
        True,
        description="whether to fit changes of brightness and contrast, to weigh residuals by"
        " their noise, to leave out highlights, saturated lines, impulses and what is printed on"
        " both images, to take off lines of a detector and lines that flicker, to leave out"
        " structures that stand still while the sample moves, and to search far away",
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
        description="side of the elements that carry E, px; half of it where inclusions are fitted"
        " in the end; none: 4, or more in large images",
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
        description="contrast over its error bars below which total variation's E is refused",
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
