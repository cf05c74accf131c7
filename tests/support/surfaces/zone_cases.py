"""What tests of zones share: a zone, its answers by one letter, and intervals."""

from beamtouch_common.outline import Span
from beamtouch_common.zones import Zone, ZoneState

GATE = Zone(from_mm=120, to_mm=200)

I, O, U = ZoneState.INSIDE, ZoneState.OUTSIDE, ZoneState.UNSURE  # noqa: E741  # as short as the rows need


def at(middle: float, half: float = 1.0) -> Span:
    """Return the interval of so much on either side of its middle."""
    return Span(middle, middle - half, middle + half)
