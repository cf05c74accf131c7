"""Errors that the user can mend; a command prints their one line and ends with exit code 2."""


class SceneError(ValueError):
    """A scene that is malformed, contradicts itself, or cannot be modelled; the message says what to change."""
