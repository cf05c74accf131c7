"""An interval and a zone of the beam: inside, outside, or unsure."""

import pytest

from beamtouch_common.outline import BEAM_AXIS, Outline, Span
from beamtouch_common.zones import BEGIN, Zone, ZoneState
from support.surfaces.zone_cases import GATE, I, O, U, at

PRESSED = Zone(from_mm=120, to_mm=200, least_force_n=5, largest_force_n=15)
LENGTH_MM = 400.0


@pytest.mark.promise(
    "docs/how-to/zones.md",
    "all of the interval, of the position and of the force if the zone bounds it",
)
@pytest.mark.parametrize(
    ("zone", "position", "force", "lies"),
    [
        (GATE, at(150), None, I),
        (GATE, at(121.69), None, I),
        (GATE, at(121.67), None, U),
        (GATE, at(118.33), None, U),
        (GATE, at(118.31), None, O),
        (GATE, at(198.3), None, I),
        (GATE, at(202), None, O),
        (GATE, at(160, 50), None, U),
        # Each side has a width of its own.
        (GATE, Span(123, 122, 180), None, U),
        (GATE, Span(123, 122, 160), None, I),
        # A contact is not beyond the ends of the beam.
        (Zone(from_mm=0, to_mm=120), Span(1, -3, 4), None, I),
        (Zone(from_mm=300, to_mm=400), at(399.5, 2), None, I),
        # A force out of bounds is enough for `outside`; a force that is not known, for `unsure`.
        (PRESSED, at(150), at(10), I),
        (PRESSED, at(150), at(6), U),
        (PRESSED, at(150), at(3), O),
        (PRESSED, at(150), at(17), O),
        (PRESSED, at(100), at(10), O),
        (PRESSED, at(150), None, U),
        (Zone(from_mm=120, to_mm=200, largest_force_n=5), at(150), Span(1, -1, 2), I),
    ],
)
def test_an_interval_lies_to_a_zone(zone: Zone, position: Span, force: Span | None, lies: ZoneState) -> None:
    assert zone.lies({BEAM_AXIS: position}, force, Outline.of_beam(LENGTH_MM), BEGIN) is lies
