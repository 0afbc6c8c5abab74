"""What all settings have in common: their checks, and what is said of a wrong one."""

from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from eofm.errors import InputError

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
