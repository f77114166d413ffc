"""Errors that input explains, and `ArgumentError`. Any other error is a bug.

Their text is one line for each thing that is wrong: its name, the value found, the values expected.
"""


class InputError(ValueError):
    """Input that can't be used.

    Catch it to report a refusal; raise one of its subclasses where one applies.
    """


class ArgumentError(ValueError):
    """An argument of the wrong type, shape or value: a bug of the caller, unless the values come from a file."""


class OutOfRangeError(InputError):
    """A value outside the range of a model or a method."""


class InsufficientDataError(InputError):
    """Data that do not suffice for a result: too few detectors, scans, samples, modes, skies or observations."""
