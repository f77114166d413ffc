"""Errors that a user's input explains, and when to raise them.

Each is an `InputError`; its text is one line for each thing that is wrong: file, key, value found, values expected.

===================== =================================================================================================
Raise                 for
===================== =================================================================================================
SceneError            a scene, an option or an argument that can't be run; the text names the key or the option
NotForecastableError  a scene that can be run, but that the closed forms of a forecast do not cover
OutOfRangeError       an argument outside the range of a physical model or a method, where the scene's key is not known;
                      the caller that knows the key raises a SceneError instead
InsufficientDataError too few detectors, scans, modes, skies or observations for a score, a fit or a figure
InputError            text that is no quantity, file or option: the caller adds its name
ValueError, TypeError a call that is wrong in itself, such as arrays of unequal shapes: a bug
===================== =================================================================================================

Catch the narrowest class. Never catch ValueError except around `int`, `float`, `Fraction`, `json` or `tomllib`: numpy
raises it for unequal shapes, and a bug would read "not scored". Errors of one package stay there: `EngineError`
(a worker or the cluster), `CheckpointError`, `OutputError`, `NoResultsError` (files of a run).
"""

from mapmaker.errors import InputError, InsufficientDataError, OutOfRangeError

__all__ = ["InputError", "InsufficientDataError", "NotForecastableError", "OutOfRangeError", "SceneError"]


class SceneError(InputError):
    """A scene that can't be run; the text has one line for each error: file, key, found, allowed."""


class NotForecastableError(SceneError):
    """A scene that can be run, but that a forecast does not cover."""
