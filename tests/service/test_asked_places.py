"""The places at which a commissioning asks for presses: of its sensors, and in each part of the range of contacts."""

import pytest

from beamtouch_models.runtime import Metadata, ModelFile, State
from beamtouch_models.runtime.metadata_parts import Ranges, SmallestForce
from beamtouch_service.commissioning.run import CommissioningRun, PressDecision, marks
from beamtouch_service.samples import Quality, Sample
from support.surfaces.small_model import PLATE_OUTPUTS, model_of


def metadata_of(ranges: Ranges, smallest: SmallestForce) -> Metadata:
    model = model_of() if ranges.across_mm is None else model_of(channels=4, outputs=PLATE_OUTPUTS)
    return model.metadata.model_copy(update={"ranges": ranges, "smallest_force": smallest})


def beam(forces_n: dict[float, float | None]) -> Metadata:
    """Return a beam with contacts of up to 8 N from 10 to 310 mm, and the least force that is seen at some places."""
    smallest = SmallestForce(position_mm=list(forces_n), force_n=list(forces_n.values()))
    return metadata_of(Ranges(position_mm=(10, 310), force_n=(0.5, 8.0)), smallest)


def at_mm(metadata: Metadata) -> list[float]:
    return [place["position"] for place in marks(metadata)]


def test_a_mark_is_the_place_nearest_to_the_middle_of_its_part_where_a_quarter_of_the_largest_force_is_seen() -> None:
    """Middles of 60, 160 and 260 mm; 2 N of 8 N."""
    first = {20.0: 0.5, 39.7: 2.0, 65.0: 2.1, 90.0: 0.5}
    second = {110.0: 0.1, 129.0: 3.0, 155.0: None, 170.0: 5.0, 210.0: 0.1}
    assert at_mm(beam({**first, **second, 300.0: None})) == [40.0, 170.0, 260.0]
    # Where nothing is seen, in the middle, and where no place of a part is known.
    assert at_mm(beam({60.0: None})) == [60.0, 160.0, 260.0]
    # The end of a part is in neither.
    assert at_mm(beam({110.0: 0.1, 140.0: 0.1, 209.0: 0.1, 210.0: 0.1})) == [60.0, 140.0, 260.0]


def test_a_plate_has_a_mark_in_each_quarter() -> None:
    """Of 200 by 100 mm, with middles at 50 and 150, and at 25 and 75 mm."""
    places = [(50.0, 45.0), (35.0, 12.0), (190.0, 75.0), (150.0, 99.0)]
    smallest = SmallestForce(
        position_mm=[x for x, _ in places], across_mm=[y for _, y in places], force_n=[1.0, 1.0, 1.0, 1.0]
    )
    plate = metadata_of(Ranges(position_mm=(0, 200), across_mm=(0, 100), force_n=(1, 8)), smallest)
    assert [tuple(place.values()) for place in marks(plate)] == [
        (35.0, 12.0),  # 20 mm from the middle is farther than 15 and 13 mm
        (50.0, 75.0),
        (150.0, 25.0),
        (150.0, 99.0),
    ]
    assert list(marks(plate)[0]) == ["x", "y"]


def test_a_press_above_a_sensor_is_asked_for_where_the_model_knows_contacts() -> None:
    """It knows them from 1 to 399 mm; the fourth sensor is at 400 mm."""
    run = CommissioningRun("run", "press-7", model_of(channels=4), 500.0, 0)
    assert [sensor.at_mm["position"] for sensor in run.report.sensors] == [100.0, 200.0, 300.0, 399.0]
    assert (run.steps, len(run.report.places)) == (7, 3)


def take(run: CommissioningRun, deflection_mm: float, first: int) -> int:
    """Take a second of samples, 10 ms apart, of which the first channel shows this; return the number of the next."""
    channels, good = run.model.channels, [Quality.GOOD] * len(run.model.channels)
    moved_mm: list[float | None] = [deflection_mm, *[0.0] * (len(channels) - 1)]
    for number in range(first, first + 102):
        sample = Sample(sequence=number, acquired_unix_us=10_000 * number, deflection_mm=moved_mm, quality=good)
        for _ in run.take("boot-0001", channels, sample, PressDecision(State.CLEAR)):
            pass
    return first + 102


@pytest.mark.parametrize(
    ("model", "of_sensor", "of_mark"),
    [
        (model_of(), "above s1, 100 mm from the left end", "at the mark, 67 mm from the left end"),
        (
            model_of(channels=4, outputs=PLATE_OUTPUTS),
            "above s1, at x 100 and y 50 mm",
            "at the mark, at x 100 and y 76 mm",
        ),
    ],
    ids=["beam", "plate"],
)
def test_each_step_says_what_to_do(model: ModelFile, of_sensor: str, of_mark: str) -> None:
    run, kind = CommissioningRun("run", "press-7", model, 500.0, 0), model.metadata.outline.kind
    at_rest = f"Take everything off the {kind}, and wait until it lies still."
    assert (run.prompt, run.held) == (at_rest, 0.0)
    number = take(run, 0.0, 1)
    assert run.prompt == f"Press {of_sensor}, firmly, for a second or two."
    sample = Sample(
        sequence=number,
        acquired_unix_us=10_000 * number,
        deflection_mm=[0.5, *[0.0] * (len(model.channels) - 1)],
        quality=[Quality.GOOD] * len(model.channels),
    )
    assert list(run.take("boot-0001", model.channels, sample, PressDecision(State.CLEAR))) == []
    assert run.prompt == "Hold."
    number = take(run, 0.5, number + 1)
    assert run.prompt == f"Seen. Lift, and wait until the {kind} lies still."
    while run.step < len(run.report.sensors):
        run.skip()
        assert run.prompt == at_rest
    number = take(run, 0.0, number)
    assert run.prompt == f"Press {of_mark}, firmly, for a second or two."
    while not run.is_done:
        assert run.at_mm == run.report.places[run.step - len(run.report.sensors)].at_mm
        run.skip()
    assert (run.at_mm, run.stage, run.step) == (None, None, run.steps)
    assert run.prompt == "Every step is done. Read the verdict, and put it on record."
