"""Compares the beams of two models: length and sensor positions. Pure."""

from beamtouch_models.modelfile import Metadata

LENGTH_PERCENT = 0.1
"""Lengths that differ by more than this belong to two beams. Less is rounding."""
MOVED_PERCENT, MOVED_MM = 1.0, 5.0
"""A sensor may move by this share of the length, but by no more than this distance. That allows for positions that were
measured again. A calibration moves no sensor: it states the true positions beside the layout."""


def difference(old: Metadata, new: Metadata) -> str | None:
    """Return how the beam of a new model differs from that of the old one; None if it is the same beam.

    Channels may change their names, but one that keeps its name must keep its position.
    """
    if abs(new.length_mm - old.length_mm) > LENGTH_PERCENT / 100 * old.length_mm:
        return f"its beam is {new.length_mm:g} mm long, the one in use {old.length_mm:g} mm"
    if len(new.layout) != len(old.layout):
        return f"it has {len(new.layout)} channels, the one in use {len(old.layout)}"
    max_moved_mm = min(MOVED_MM, MOVED_PERCENT / 100 * old.length_mm)
    places = {channel.name: channel.position_mm for channel in old.layout}
    ordered = zip(
        sorted(new.layout, key=lambda channel: channel.position_mm),
        sorted(old.layout, key=lambda channel: channel.position_mm),
        strict=True,
    )
    for channel, nearest in ordered:
        old_mm = places.get(channel.name, nearest.position_mm)
        if abs(channel.position_mm - old_mm) > max_moved_mm:
            return f"its {channel.name} is at {channel.position_mm:g} mm, in the one in use at {old_mm:g} mm"
    return None
