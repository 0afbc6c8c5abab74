"""Exceptions for input that cannot be used, or not for all that was asked of it."""


class InputError(ValueError):
    """What is wrong, where, and what to do, in one line for the user.

    Names that come from files may hold anything; what cannot be printed is said as its code.
    """

    def __init__(self, text: str = "") -> None:
        super().__init__("".join(c if c.isprintable() else repr(c)[1:-1] for c in text))


class UndeterminedError(InputError):
    """What images do not tell; all else that was asked of them can be had."""
