"""Whether two models are of the same beam: the same length, and sensors in the same places. Pure."""

from beamtouch_models.modelfile import Metadata

LENGTH_PERCENT = 0.1
"""Lengths further apart than this are of two beams: less is rounding."""
MOVED_PERCENT, MOVED_MM = 1.0, 5.0
"""A sensor may stand elsewhere by this much of the length, and by this much at most, as where positions were measured
again. A calibration moves none: it states where they truly are beside the layout."""


def difference(old: Metadata, new: Metadata) -> str | None:
    """Say how the beam of a new model differs from that of the old one; None if it is the same beam.

    Channels may have other names, since samples name theirs; one that keeps its name keeps its place.
    """
    if abs(new.length_mm - old.length_mm) > LENGTH_PERCENT / 100 * old.length_mm:
        return f"its beam is {new.length_mm:g} mm long, the one in use {old.length_mm:g} mm"
    if len(new.layout) != len(old.layout):
        return f"it has {len(new.layout)} channels, the one in use {len(old.layout)}"
    most_mm = min(MOVED_MM, MOVED_PERCENT / 100 * old.length_mm)
    places = {channel.name: channel.position_mm for channel in old.layout}
    ordered = zip(
        sorted(new.layout, key=lambda channel: channel.position_mm),
        sorted(old.layout, key=lambda channel: channel.position_mm),
        strict=True,
    )
    for channel, nearest in ordered:
        old_mm = places.get(channel.name, nearest.position_mm)
        if abs(channel.position_mm - old_mm) > most_mm:
            return f"its {channel.name} is at {channel.position_mm:g} mm, in the one in use at {old_mm:g} mm"
    return None
