"""Errors that end a command with one line and an exit code, without a traceback."""


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line that says what to do. Exit code 2."""


class SceneError(InputError):
    """A scene that is malformed, contradicts itself, or cannot be modelled; the message says what to change."""


class NotGoodEnoughError(RuntimeError):
    """The input is right and the result is not fit for use, so nothing was written; the message has the figures.

    Exit code 1.
    """
