"""Errors of models and scenes, and the check of an argument's kind. Their bases give the exit code (`common`)."""

from beamtouch_common.errors import FailedError, InputError

__all__ = ["WRONG_INPUT_ERRORS", "InputError", "ModelFileError", "NotGoodEnoughError", "SceneError", "require"]

WRONG_INPUT_ERRORS = (InputError, OSError)
"""Wrong input of `design-sensors` and `beamtouch-rig`: all files and devices that they use are given by the user."""


class SceneError(InputError):
    """A scene is malformed, contradicts itself, or cannot be modelled; the message says what to change."""


class ModelFileError(InputError):
    """A file is not a model, or the model does not give its own golden answers."""


class NotGoodEnoughError(FailedError):
    """The result is not fit for use and was not written. The message has the figures."""


def require(value: object, kind: type, name: str, wanted: str) -> None:
    """Raise SceneError unless an argument is of this kind; `wanted` says in words which."""
    if not isinstance(value, kind):
        raise SceneError(f"{name}: give {wanted}, not {type(value).__name__} {str(value)[:40]!r}")
