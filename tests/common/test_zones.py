"""An interval and a zone of the beam: inside, outside, or unsure."""

import pytest
from pydantic import ValidationError

from beamtouch_common.outline import BEAM_AXIS, Outline, Span
from beamtouch_common.zones import BEGIN, MAX_ZONES, Zone, ZoneState, first_conflict
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


PLATE = Outline({"x": 400.0, "y": 300.0})
CORNER = Zone(x_mm=(0, 120), y_mm=(200, 300))


@pytest.mark.promise(
    "docs/how-to/zones.md",
    "On a plate, a zone is a rectangle, and the interval of each axis must lie in it",
)
@pytest.mark.parametrize(
    ("x", "y", "lies"),
    [
        (at(60), at(250), I),
        (at(118.3), at(250), I),
        (at(118.4), at(250), U),
        (at(60), at(200), U),
        (at(60), at(198.3), O),
        # Outside along one axis is outside, however uncertain the other one is.
        (at(60, 100), at(100), O),
        (at(130), at(250, 90), O),
        # A contact is not beyond the edges of the plate.
        (Span(1, -3, 4), Span(299, 297, 303), I),
    ],
)
def test_intervals_lie_to_a_rectangle(x: Span, y: Span, lies: ZoneState) -> None:
    assert CORNER.lies({"x": x, "y": y}, None, PLATE, BEGIN) is lies


BEAM: dict[str, object] = {"from_mm": 120, "to_mm": 200}


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"x_mm": (0, 9)}, "a zone needs from_mm and to_mm on a beam, x_mm and y_mm on a plate"),
        ({"x_mm": (0, 9), "y_mm": (0, 9), "to_mm": 9}, "a zone needs from_mm and to_mm on a beam"),
        ({}, "a zone needs from_mm and to_mm on a beam, x_mm and y_mm on a plate"),
        ({"x_mm": (0, 9), "y_mm": (9, 9)}, r"y_mm\[0\] = 9 must be less than y_mm\[1\] = 9"),
        ({"x_mm": (0, 9, 10), "y_mm": (0, 9)}, "at most 2 items"),
        ({"from_mm": 9, "to_mm": 9}, "from_mm = 9 must be less than to_mm = 9"),
        ({"from_mm": -1, "to_mm": 9}, "greater than or equal to 0"),
        ({"x_mm": (9, 3), "y_mm": (0, 9)}, r"x_mm\[0\] = 9 must be less than x_mm\[1\] = 3"),
        ({"x_mm": (-1, 3), "y_mm": (0, 9)}, "greater than or equal to 0"),
        (BEAM | {"least_force_n": 5, "largest_force_n": 5}, "least_force_n = 5 must be less than largest_force_n = 5"),
        (BEAM | {"least_force_n": -1}, "greater than or equal to 0"),
        (BEAM | {"dwell_ms": -1}, "greater than or equal to 0"),
        (BEAM | {"dwell_ms": 3_600_001}, "less than or equal to 3600000"),
    ],
)
def test_edges_of_a_zone_that_make_none_are_refused(keys: dict[str, object], reason: str) -> None:
    with pytest.raises(ValidationError, match=reason):
        Zone.model_validate(keys)


def test_a_zone_is_of_a_beam_or_of_a_plate() -> None:
    assert CORNER.conflict(PLATE, estimates_force=False) == ""
    wide = Zone(x_mm=(0, 120), y_mm=(200, 310))
    assert wide.conflict(PLATE, estimates_force=False) == (
        "y_mm ends at 310, beyond the edge of a plate of 400 by 300 mm: 300 mm along y"
    )
    assert GATE.conflict(PLATE, estimates_force=False) == "a zone of a plate of 400 by 300 mm has x_mm and y_mm"
    assert CORNER.conflict(Outline.of_beam(400), estimates_force=False) == (
        "a zone of a beam of 400 mm has from_mm and to_mm"
    )
    assert CORNER.model_dump(exclude_none=True)["x_mm"] == (0, 120)
    assert "x_mm" not in GATE.model_dump()


def test_a_zone_may_reach_from_one_end_to_the_other_and_hold_for_an_hour() -> None:
    whole = Zone(from_mm=0, to_mm=400, least_force_n=0, largest_force_n=1e-9, dwell_ms=3_600_000)
    assert whole.conflict(Outline.of_beam(400.0), estimates_force=True) == ""
    assert MAX_ZONES == 6


def test_a_zone_beyond_the_beam_or_of_a_force_that_is_not_estimated_is_a_conflict() -> None:
    beam = Outline.of_beam(LENGTH_MM)
    beyond = Zone(from_mm=0, to_mm=400.5)
    end = "to_mm = 400.5 is beyond the end of the beam, which is 400 mm long"
    assert beyond.conflict(beam, estimates_force=False) == end
    force = 'a bound of the force needs a scene with "force" in its descriptors'
    for bound in ({"least_force_n": 5.0}, {"largest_force_n": 5.0}):
        bounded = Zone.model_validate(BEAM | bound)
        assert (bounded.has_force, bounded.conflict(beam, estimates_force=False)) == (True, force)
        assert bounded.conflict(beam, estimates_force=True) == ""
    assert not GATE.has_force
    zones = {"gate": GATE, "end": beyond, "press": PRESSED}
    assert first_conflict(zones, beam, estimates_force=True) == f"end: {end}"
    assert first_conflict({"gate": GATE, "press": PRESSED}, beam, estimates_force=False) == f"press: {force}"
    assert first_conflict({"gate": GATE, "press": PRESSED}, beam, estimates_force=True) == ""


def test_a_contact_that_touches_an_edge_with_an_end_of_its_interval_is_on_either_side_of_it() -> None:
    beam, zone, soft = Outline.of_beam(LENGTH_MM), Zone(from_mm=120, to_mm=200, largest_force_n=10), Span(5, 4, 6)

    def lies(low_mm: float, high_mm: float, force: Span | None = soft) -> ZoneState:
        return zone.lies({BEAM_AXIS: Span((low_mm + high_mm) / 2, low_mm, high_mm)}, force, beam, 1.0)

    assert [lies(120, 200), lies(119.5, 200), lies(120, 200.5)] == [I, U, U]
    assert [lies(100, 120), lies(100, 119.5), lies(200, 210), lies(200.5, 210)] == [U, O, U, O]
    assert [lies(130, 140, force) for force in (Span(9, 8, 10), Span(11, 10, 12), Span(12, 10.5, 13))] == [I, U, O]
    assert lies(100, 110, None) is U  # whether it presses so hard is not known
