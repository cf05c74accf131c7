"""Errors that the user can mend; a command prints their one line and ends with exit code 2."""


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line that says what to do."""


class SceneError(InputError):
    """A scene that is malformed, contradicts itself, or cannot be modelled; the message says what to change."""
