"""The version of the distribution that this package is part of."""

from importlib.metadata import PackageNotFoundError, version


def current() -> str:
    """Return the installed version, or `0+source` when run from a source tree that is not installed."""
    try:
        return version("beamtouch")
    except PackageNotFoundError:
        return "0+source"
