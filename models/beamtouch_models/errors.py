"""Errors that end a command with one line and an exit code, without a traceback."""


class InputError(ValueError):
    """Something that the user gave is wrong; the message is one line that says what to do. Exit code 2."""


class SceneError(InputError):
    """A scene is malformed, contradicts itself, or cannot be modelled; the message says what to change."""


class ModelFileError(InputError):
    """A file is not a model, or the model does not give its own golden answers."""


class NotGoodEnoughError(RuntimeError):
    """The input is correct, but the result is not fit for use and was not written. Exit code 1.

    The message has the figures.
    """
