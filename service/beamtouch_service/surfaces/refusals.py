"""The problems of one surface, worded. Pure."""

from beamtouch_service.problems import Kind, Problem


def no_model(surface: str) -> Problem:
    """Return the problem of a surface without a model."""
    detail = "Samples are accepted, but there is no model. Give one with --model or in the config."
    return Problem(Kind.NO_MODEL, detail, surface)


def no_samples(surface: str) -> Problem:
    """Return the problem of a surface that has got no sample for its model."""
    detail = "No sample has arrived since the service started. Start the daemon, or check its log."
    return Problem(Kind.NO_SAMPLES, detail, surface)


def stale(surface: str, age_ms: float, stale_ms: float) -> Problem:
    """Return the problem of a newest sample of this age, which is over the limit."""
    detail = (
        f"The newest sample is {age_ms:.1f} ms old; the limit is {stale_ms:g} ms. "
        "Check that the daemon runs and reaches the device."
    )
    return Problem(Kind.STALE, detail, surface, {"age_ms": age_ms, "stale_ms": stale_ms})


def missing_channels(surface: str, missing: list[str]) -> Problem:
    """Return the problem of a batch without these channels."""
    detail = f"The batch lacks {', '.join(missing)}. Send every channel of the model; mark a broken one as missing."
    return Problem(Kind.MISSING_CHANNELS, detail, surface, {"missing_channels": missing})


def busy(surface: str) -> Problem:
    """Return the problem of a late batch without room."""
    detail = "Late samples come faster than they can be recorded; send the batch again."
    return Problem(Kind.BUSY, detail, surface)


def changed_channels(surface: str, changed: list[str]) -> Problem:
    """Return the problem of channels that have changed."""
    detail = f"{', '.join(changed)} changed; GET /surfaces/{surface} says how. Check it, then calibrate the model."
    return Problem(Kind.CHANGED_CHANNELS, detail, surface, {"changed_channels": changed})
