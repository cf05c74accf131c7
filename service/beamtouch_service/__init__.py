"""The service: takes samples, answers `GET /contact`, keeps a record of contacts."""


def version() -> str:
    """Return the installed version, or `0+source` when run from a source tree that is not installed."""
    # Imported here because a gateway imports this package only for the format of samples.
    from importlib import metadata  # noqa: PLC0415

    try:
        return metadata.version("beamtouch")
    except metadata.PackageNotFoundError:
        return "0+source"
