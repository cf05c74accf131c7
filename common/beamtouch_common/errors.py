"""The two errors that end any command with one line and an exit code, without a traceback."""


class InputError(ValueError):
    """Wrong input from the user; the message is one line that says what to do. Exit code 2."""


class FailedError(RuntimeError):
    """The input is right, but the work failed; each argument is one line that says why. Exit code 1."""
