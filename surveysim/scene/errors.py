"""The error of a scene that can't be run, in a module that imports nothing."""


class SceneError(ValueError):
    """A scene that can't be run; the text has one line for each error: file, key, found, allowed."""
