"""The text of a commissioning, line by line."""

import pytest

from beamtouch_models.runtime import State
from beamtouch_service.commissioning.report import Finding, PlaceResult, Report, SensorResult, as_text

HEAD = {"surface": "press-7", "model": "press-7@1a2b", "beam": "beam-9", "begun_at": "2025-11-21T12:00:00.000Z"}


def report(**members: object) -> Report:
    sensors = [
        SensorResult(
            name="s1",
            at_mm={"position": 68.0},
            finding=Finding.RIGHT,
            says="moves as it should",
            share=0.987,
            moved_mm={"s1": 0.51234, "s2": None},
        ),
        SensorResult(name="s2", at_mm={"position": 244.0}),
    ]
    places = [
        PlaceResult(
            at_mm={"position": 100.0},
            state=State.CONTACT,
            stated_mm={"position": (102.25, 99.0, 104.5)},
            error_mm={"position": 2.25},
            says="+2.2 mm, within 7.8 mm",
        ),
        PlaceResult(at_mm={"position": 200.0}),
    ]
    return Report.model_validate(HEAD | {"sensors": sensors, "places": places} | members)


def test_a_commissioning_that_goes_on_has_what_is_known_so_far() -> None:
    assert as_text(report(verdict=["Press on."])).splitlines() == [
        "Commissioning of a Beamtouch surface",
        "",
        "surface   press-7",
        "model     press-7@1a2b",
        "beam      beam-9",
        "begun     2025-11-21T12:00:00.000Z",
        "confirmed not yet",
        "result    not finished",
        "",
        "Press on.",
        "",
        "Presses above the sensors: movement of each channel in mm, from rest",
        "above  at mm      s1  s2  share  finding",
        "s1      68.0  0.5123   -   99 %  moves as it should",
        "s2     244.0       -   -      -",
        "",
        "Presses at marked places",
        "mark mm  says mm  95 % interval   error mm  result",
        "  100.0    102.2  99.0 ... 104.5       2.2  +2.2 mm, within 7.8 mm",
        "  200.0        -  -                      -",
    ]


@pytest.mark.parametrize(
    ("members", "confirmed", "result"),
    [
        (
            {"ended_at": "2025-11-21T13:00:00.000Z", "by": "Ann", "passed": True},
            "2025-11-21T13:00:00.000Z by Ann",
            "PASSED",
        ),
        ({"ended_at": "2025-11-21T13:00:00.000Z", "passed": False}, "2025-11-21T13:00:00.000Z", "NOT PASSED"),
    ],
)
def test_a_commissioning_that_was_confirmed_says_by_whom(
    members: dict[str, object], confirmed: str, result: str
) -> None:
    lines = as_text(report(**members)).splitlines()
    assert lines[6:8] == [f"confirmed {confirmed}", f"result    {result}"]


def test_movements_in_another_unit_have_four_digits_and_places_of_a_plate_both_coordinates() -> None:
    sensor = SensorResult(name="s1", at_mm={"x": 10.0, "y": 25.5}, moved_mm={"s1": 12_345.678}, share=-1.0)
    place = PlaceResult(at_mm={"x": 50.0, "y": 75.0}, stated_mm={"x": (51.0, 50.0, 52.0), "y": (70.0, 69.5, 71.25)})
    lines = as_text(report(unit="ue", sensors=[sensor], places=[place])).splitlines()
    assert lines[10:] == [
        "Presses above the sensors: movement of each channel in ue, from rest",
        "above       at mm     s1   share  finding",
        "s1     10.0, 25.5  12350  -100 %",
        "",
        "Presses at marked places",
        "   mark mm     says mm  95 % interval                 error mm  result",
        "50.0, 75.0  51.0, 70.0  50.0 ... 52.0, 69.5 ... 71.2         -",
    ]
