"""How the figures of an event on record become those of an answer: times, lengths and their order."""

import json
from typing import Any, TypedDict, Unpack

from beamtouch_service.record import Begin, End, Event, EventKind, Numbered, encode_event

TOUCHED_US = 1_763_726_400_000_000
"""2025-11-21T12:00:00Z."""


class Members(TypedDict, total=False):
    """What an event holds beside its begin and its last sample."""

    lifted_us: int | None
    end: End
    unexplained_us: int
    ends_unexplained: bool
    place: dict[str, list[float | None] | None]
    zones: dict[str, int]
    degraded: bool
    path: list[list[float]]
    unsteady: bool


def event(lasts_us: int, **members: Unpack[Members]) -> Event:
    """Return an event whose last sample is so long after its first one, on a beam unless `place` has other axes."""
    head = "press-7", "press-7@1a2b3c", "boot-0001", 7, 9, TOUCHED_US, TOUCHED_US + lasts_us
    return Event(*head, EventKind.CONTACT, Begin.TOUCH, **Members(place={"position": None}) | members)


def answer(one: Event, *, path: bool = False) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(encode_event(Numbered(31, one), path=path))
    return found


def test_an_event_lasts_to_its_lift_or_to_its_last_sample() -> None:
    assert answer(event(12_345))["dwell_ms"] == 12.345
    lifted = answer(event(12_345, lifted_us=TOUCHED_US + 20_001, end=End.LIFT))
    assert (lifted["dwell_ms"], lifted["lifted_at"]) == (20.001, "2025-11-21T12:00:00.020Z")
    assert answer(event(12_345))["lifted_at"] is None
    # A single sample, and the clock of a sender that was set back by 0.4 ms.
    assert [answer(event(lasts_us))["dwell_ms"] for lasts_us in (0, 400, -400)] == [0.0, 0.4, 0.0]


def test_what_is_unexplained_lasts_to_the_end_only_if_the_last_sample_is() -> None:
    lifted_us = TOUCHED_US + 20_002
    for ends, lifted, unexplained_ms in ((False, lifted_us, 3.457), (True, lifted_us, 11.114), (True, None, 3.457)):
        one = event(12_345, unexplained_us=3457, ends_unexplained=ends, lifted_us=lifted)
        assert answer(one)["unexplained_ms"] == unexplained_ms
    back = event(12_345, unexplained_us=3457, ends_unexplained=True, lifted_us=TOUCHED_US + 12_000)
    assert answer(back)["unexplained_ms"] == 3.457


def test_each_figure_has_its_name() -> None:
    forces = {"mean_force_n": 4.5, "mean_force_low_n": 4.0, "mean_force_high_n": 5.5}
    forces |= {"peak_force_n": 7.5, "peak_force_low_n": 6.0, "peak_force_high_n": 8.5}
    place: dict[str, list[float | None] | None] = {
        "x": [150.0, 148.0, 153.0, 120.0, 190.0, 175.0],
        "y": [31.0, 30.5, 31.75, 29.0, 35.0, None],
    }
    one = event(9000, place=place, zones={"gate": 1234, "far": 4000}, degraded=True, unsteady=True)
    figures = forces | {"samples": 12, "unsteady_samples": 5}
    for name, value in figures.items():
        setattr(one, name, value)
    found = answer(one)
    assert {name: found[name] for name in figures} == figures
    assert found["unsteady"] is True
    assert (found["id"], found["boot_id"], found["model"], found["quality"]) == (
        *(31, "boot-0001", "press-7@1a2b3c"),
        "degraded",
    )
    names = ("mean_{0}_mm", "mean_{0}_low_mm", "mean_{0}_high_mm", "min_{0}_mm", "max_{0}_mm", "peak_{0}_mm")
    for axis in ("x", "y"):
        assert [found[name.format(axis)] for name in names] == place[axis]
    assert found["zones"] == {"gate": 1.234, "far": 4.0}
    beam = answer(event(9000))
    assert "zones" not in beam
    assert (beam["quality"], beam["unsteady"], beam["unsteady_samples"], beam["end"]) == ("good", False, 0, "open")
    assert [beam[name.format("position")] for name in names] == [None] * 6


def test_a_path_has_the_times_and_figures_of_its_stays() -> None:
    with_force = event(9000, path=[[0, 1500, 0, 150.0, 149.0, 152.0, 5.0, 4.0, 7.0]])
    assert answer(with_force, path=True)["path"] == [
        {
            "at": "2025-11-21T12:00:00.000Z",
            "lasts_ms": 1.5,
            "unsteady": False,
            "position_mm": 150.0,
            "position_low_mm": 149.0,
            "position_high_mm": 152.0,
            "force_n": 5.0,
            "force_low_n": 4.0,
            "force_high_n": 7.0,
        }
    ]
    assert "path" not in answer(with_force)
    without = event(9000, path=[[0, 1, 0, 1.0, 0.5, 2.0], [2_007_000, 3333, 1, 3.0, 2.5, 4.0]])
    (_, stay) = answer(without, path=True)["path"]
    assert stay == {
        "at": "2025-11-21T12:00:02.007Z",
        "lasts_ms": 3.333,
        "unsteady": True,
        "position_mm": 3.0,
        "position_low_mm": 2.5,
        "position_high_mm": 4.0,
        "force_n": None,
        "force_low_n": None,
        "force_high_n": None,
    }
