"""The one exception for input that cannot be used."""


class InputError(ValueError):
    """What is wrong, where, and what to do, in one line for the user."""
