"""The problems of one surface, worded. Pure."""

from collections.abc import Mapping

from beamtouch_models.modelfile import Metadata
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.surfaces.channels_out import ChannelOut


def no_model(surface: str, reason: str | None) -> Problem:
    """Return the problem of a surface without a model; `reason`: why its file is not used, if it has one."""
    detail = "Samples are accepted, but there is no model. Give one with --model or in the config."
    if reason is not None:
        detail = f"Samples are accepted, but its model file cannot be used. {reason}"
    return Problem(Kind.NO_MODEL, detail, surface)


def no_samples(surface: str) -> Problem:
    """Return the problem of a surface that has got no sample for its model."""
    detail = "No sample has arrived since the service started. Start the daemon, or check its log."
    return Problem(Kind.NO_SAMPLES, detail, surface)


def other_beam(surface: str, model: Metadata, sender_beam: str | None) -> Problem:
    """Return the problem of samples of a beam that the model is not of."""
    detail = (
        f"The samples are of beam {sender_beam}, the model is of beam {model.beam}. Give the service the model of "
        f"{sender_beam}, or the daemon the configuration that was built with this model ({_described(model)})."
    )
    return Problem(Kind.OTHER_BEAM, detail, surface, {"sender_beam": sender_beam, "model_beam": model.beam})


def _described(model: Metadata) -> str:
    """Return the beam and layout of a model in a few words."""
    places = ", ".join(f"{channel.name} {channel.position_mm:g}" for channel in model.layout)
    return f"{model.length_mm:g} mm; {places}"


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


def channels_out(surface: str, out: Mapping[str, ChannelOut]) -> Problem:
    """Return the problem of channels that have been out for too long."""
    named = ", ".join(f"{name} ({one.quality.value} since {one.since})" for name, one in out.items())
    found = {name: one.model_dump(mode="json") for name, one in out.items()}
    return Problem(
        Kind.CHANNELS_OUT, f"The contact is found without {named}. Check it.", surface, {"channels_out": found}
    )


def changed_channels(surface: str, changed: list[str]) -> Problem:
    """Return the problem of channels that have changed."""
    detail = f"{', '.join(changed)} changed; GET /surfaces/{surface} says how. Check it, then calibrate the model."
    return Problem(Kind.CHANGED_CHANNELS, detail, surface, {"changed_channels": changed})
