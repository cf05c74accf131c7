"""The problems that a surface has instead of a contact or a good health, each with what to do. Pure."""

from collections.abc import Mapping

from beamtouch_models.runtime import Metadata
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.samples import Quality
from beamtouch_service.surfaces.channels import ChannelHealth, ChannelOut
from beamtouch_service.surfaces.contact import rfc3339


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
    """Return the problem of samples of a beam, or of another structure, that the model is not of."""
    kind = model.outline.kind
    other = "beam" if kind == "beam" else "structure"
    each = ((one.name, model.place_of(one).values()) for one in model.layout)
    places = ", ".join(f"{name} {' by '.join(f'{at_mm:g}' for at_mm in place_mm)}" for name, place_mm in each)
    detail = (
        f"The samples are of {other} {sender_beam}, the model is of {kind} {model.beam}. Give the service the model "
        f"of {sender_beam}, or the daemon the configuration that was built with this model ({model.outline}; {places})."
    )
    return Problem(Kind.OTHER_BEAM, detail, surface, {"sender_beam": sender_beam, "model_beam": model.beam})


def stale(surface: str, age_ms: float, stale_ms: float, since: str) -> Problem:
    """Return the problem of a newest sample of this age and time (RFC 3339), which is over the limit."""
    detail = (
        f"The newest sample is {age_ms:.1f} ms old; the limit is {stale_ms:g} ms. "
        "Check that the daemon runs and reaches the device."
    )
    return Problem(Kind.STALE, detail, surface, {"age_ms": age_ms, "stale_ms": stale_ms, "since": since})


def missing_channels(surface: str, missing: list[str]) -> Problem:
    """Return the problem of a batch without these channels."""
    detail = f"The batch lacks {', '.join(missing)}. Send every channel of the model; mark a broken one as missing."
    return Problem(Kind.MISSING_CHANNELS, detail, surface, {"missing_channels": missing})


def too_few_channels(surface: str, working: int, needed: int, bad: dict[str, Quality]) -> Problem:
    """Return the problem of a sample with fewer working channels than the model needs."""
    named = ", ".join(f"{name} ({quality.value})" for name, quality in bad.items())
    works = "1 channel works" if working == 1 else f"{working} channels work"
    detail = f"Only {works}; the model needs {needed}. Check {named}."
    return Problem(Kind.TOO_FEW_CHANNELS, detail, surface, {"bad_channels": dict(bad)})


def channels_out(surface: str, out: Mapping[str, ChannelOut]) -> Problem:
    """Return the problem of channels that have been out for too long."""
    named = ", ".join(f"{name} ({one.quality.value} since {one.since})" for name, one in out.items())
    members: dict[str, object] = {"channels_out": {name: one.model_dump(mode="json") for name, one in out.items()}}
    members["since"] = min(one.since for one in out.values())
    return Problem(Kind.CHANNELS_OUT, f"The contact is found without {named}. Check it.", surface, members)


def changed_channels(surface: str, changed: Mapping[str, ChannelHealth]) -> Problem:
    """Return the problem of channels that have changed."""
    members = {"changed_channels": list(changed), "since": min(one.since for one in changed.values())}
    detail = f"{', '.join(changed)} changed; GET /surfaces/{surface} says how. Check it, then calibrate the model."
    return Problem(Kind.CHANGED_CHANNELS, detail, surface, members)


def zeros_moved(surface: str) -> Problem:
    """Return the problem of zeros that have moved together, or nearly as far as the daemon follows them."""
    detail = (
        "Zeros have moved, as in warmth. Wait until the surface no longer warms or cools, take "
        "everything off it, then tare."
    )
    return Problem(Kind.ZEROS_MOVED, detail, surface)


def unexplained(surface: str, kind: str, after_s: float, since_us: int | None, suspect: str | None) -> Problem:
    """Return the problem of a stretch on a beam or a plate that lasts too long.

    Parameters
    ----------
    kind : beam or plate
    since_us : time of its first sample [us since 1970]
    suspect : the channel of `check-NAME`
    """
    look = f"Check sensor {suspect}." if suspect else f"Look for a second load and for anything under the {kind}."
    detail = f"Neither rest nor a single contact has explained the samples for over {after_s:g} s. {look}"
    return Problem(Kind.UNEXPLAINED, detail, surface, {"suspect": suspect, "since": since_us and rfc3339(since_us)})


def unusable_estimate(surface: str, detail: str) -> Problem:
    """Return the problem of a sample whose estimate cannot be served."""
    return Problem(Kind.UNUSABLE_ESTIMATE, detail, surface)
