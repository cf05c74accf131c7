"""What a report answers to a customer, sentence by sentence, for a model that is small enough to compute by hand."""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models import change_scene, read_scene
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.report.questions import can, cannot, noun_of, overload_of, questions
from beamtouch_models.design.pricing.effect import Effect, Verdict
from beamtouch_models.design.surface import Surface, resolve
from beamtouch_models.runtime.metadata import Metadata
from beamtouch_models.runtime.metadata_parts import FilterChoice, Influence, SinceTouch
from support.surfaces.example_scenes import SCENES
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

BENCH = read_scene(SCENES / "bench.toml")


@pytest.fixture(scope="module")
def surface() -> Surface:
    return resolve(BENCH)


def metadata_with(influence: list[list[float]] | None = None, **parts: object) -> Metadata:
    """Of three sensors, 3 mm off at rest, which measure from 1 to 4 mm, under 1 to 20 N."""
    metadata = model_of().metadata
    update = dict(parts) | ({} if influence is None else {"influence": Influence(mm_per_n=influence)})
    return metadata.model_copy(update=update)


def answers(surface: Surface, metadata: Metadata) -> dict[str, str]:
    return {each.asked: each.answer for each in questions(surface, metadata, (1.234, 2.345), 0.5678, 2.01)}


ROWS = [[0.01, 0.05, 0.02], [0.03, 0.02, -0.04], [0.01, 0.01, 0.01], [0.02, 0.04, 0.01]]


def test_a_sensor_leaves_its_range_at_whichever_end_is_nearer_in_forces() -> None:
    """2 mm towards the sensor by at most 0.05 mm/N, and 1 mm away from it by at most 0.04."""
    over = overload_of(metadata_with(ROWS))
    assert (over.leaves_range_n, over.touches_n) == pytest.approx((25.0, 60.0))
    down = [[abs(value) for value in row] for row in ROWS]
    over = overload_of(metadata_with(down))
    assert (over.leaves_range_n, over.touches_n) == pytest.approx((40.0, 60.0))
    up = overload_of(metadata_with([[-value for value in row] for row in down]))
    assert up.leaves_range_n == pytest.approx(20.0)
    assert up.touches_n == np.inf


def test_sensors_of_another_unit_leave_their_range_upwards_and_touch_nothing() -> None:
    layout = [channel.model_copy(update={"unit": "uV/V"}) for channel in model_of().metadata.layout]
    over = overload_of(metadata_with(ROWS, layout=layout))
    assert over.leaves_range_n == pytest.approx(min(1 / 0.05, 2 / 0.04))
    assert over.touches_n == np.inf


def test_a_larger_force_is_answered_with_the_forces_at_which_something_happens(surface: Surface) -> None:
    down = [[0.01, 0.05, 0.02], [0.03, 0.02, 0.04], [0.01, 0.01, 0.01], [0.02, 0.04, 0.01]]
    told = answers(surface, metadata_with(down))["What if the force is larger?"]
    assert told == (
        "Clearly beyond 20 N, answers carry the note `overload`: do not act on them, take the load off. "
        "At 40 N at the worst place, a sensor leaves its linear range, and takes no part in the answer. "
        "At 60 N, the beam touches a sensor. "
        "Put a stop under the beam beside each sensor, 1 to 2 mm below the beam at rest: 20 N do not press it down "
        "that far, and it stops before that sensor leaves its range. It comes closest at s2, 200 mm; a stop there "
        "does not protect the others. "
        "These forces lie on gently: a sudden one bends the beam up to twice as far for a moment."
    )
    silent = model_of(outputs=("position_mm", "position_low_mm", "position_high_mm")).metadata
    said = "Beyond 20 N no note says so, as this model states no force (`requirements.descriptors`). "
    assert answers(surface, silent)["What if the force is larger?"].startswith(said)
    known = metadata_with(ranges=silent.ranges.model_copy(update={"force_n": (19.0, 21.0)}))
    assert answers(surface, known)["What if the force is larger?"].startswith(
        "A force that is not 19 to 21 N gives the state `unexplained` where the sensors show the difference. "
        "Elsewhere it moves the place, and no note says so: state a tolerance that the force keeps. "
    )


def test_errors_are_told_in_the_middle_and_at_the_ends(surface: Surface) -> None:
    told = answers(surface, model_of().metadata)["What happens at the ends?"]
    assert told == (
        "The mean error is 0.57 mm in the middle third, 1.2 mm at the left end of the range "
        "and 2.3 mm at the right one. "
        "Outside 1 to 399 mm its answers mean nothing."
    )
    plate = model_of(outputs=PLATE_OUTPUTS).metadata
    assert (noun_of(plate), noun_of(model_of().metadata)) == ("plate", "beam")
    told = answers(resolve(read_scene(SCENES / "plate-on-springs.toml")), plate)["What happens along the rim?"]
    assert told == (
        "The mean error is 0.57 mm in the middle, 1.2 mm along the rim and 2.3 mm in the corners. "
        "Outside x = 1 to 399 mm or y = 1 to 299 mm its answers mean nothing."
    )


@pytest.mark.parametrize(
    ("channels", "few", "told"),
    [
        (2, 2, "A sensor that is knocked shows when nothing touches the beam: look at it, and tare."),
        (
            3,
            2,
            "A sensor that contradicts the others makes contacts `unexplained`; which one it is, so few do not show.",
        ),
        (4, 2, "A sensor that contradicts the others makes contacts `unexplained`, and is named."),
    ],
)
def test_a_failed_sensor_is_answered_by_how_many_there_are(
    surface: Surface, channels: int, few: int, told: str
) -> None:
    answer = answers(surface, model_of(channels=channels, min_channels=few).metadata)[
        "What if a sensor fails, or is knocked?"
    ]
    goes_on = (
        "Every sensor must work: without one there is no answer, and never an old one."
        if channels == few
        else f"Answers go on while {few} of {channels} sensors work, marked `degraded`; "
        "the table above has their errors. "
        "With fewer, there is no answer; never an old one."
    )
    assert answer == f"{goes_on} {told}"


def test_two_contacts_are_noticed_by_three_sensors_or_more(surface: Surface) -> None:
    def told(channels: int) -> str:
        metadata = model_of(channels=channels, min_channels=2).metadata
        return answers(surface, metadata)["What if two things touch it, or something long lies on it?"]

    assert told(2).endswith("With 2 sensors nothing notices it: each contact carries the note `unchecked`.")
    assert told(3).endswith("`design-sensors challenge` measures how often this surface notices what.")


def test_calibration_false_contacts_and_figures_are_told_with_their_numbers(surface: Surface) -> None:
    told = answers(surface, model_of().metadata)
    assert (
        "The figures hold if that leaves gains to ± 0.3 % and zeros to ± 2 µm, as standard deviations."
        in told["Who calibrates it, and when?"]
    )
    assert told["What does a false contact mean?"].startswith(
        "While nothing touches the beam, the noise of the sensors alone looks like a touch: "
    )
    assert told["How sure are these figures?"].startswith("They are simulated, for a beam, sensors and loads exactly")


def test_an_acceptance_is_of_twenty_contacts_and_seventeen_intervals(surface: Surface) -> None:
    """The error that is expected is 1 % of 400 mm."""
    told = answers(surface, model_of().metadata)["When do we accept it?"]
    assert told == (
        "Draw 20 places and forces of these ranges at random, before you see an answer, and press when the beam lies "
        "still. Accept if the mean error is at most 2.1 mm (about 4 mm are expected) "
        "and at least 17 of the 20 places lie in their intervals. "
        "A surface as stated here fails the first in one of 20 trials, and the second in one of 60."
    )
    plate = answers(resolve(read_scene(SCENES / "plate-on-springs.toml")), model_of(outputs=PLATE_OUTPUTS).metadata)
    assert plate["When do we accept it?"].endswith(
        "(about 5 mm are expected) and at least 17 of the 20 places lie in their intervals along each axis. "
        "A surface as stated here fails the first in one of 20 trials, and the second in one of 30."
    )


def test_ringing_and_warmth_are_told_of_the_scene(surface: Surface) -> None:
    told = answers(surface, model_of().metadata)
    assert surface.ringing is not None
    times = f"{surface.ringing.after_touch_s:.2g} s, after a lift for up to {surface.ringing.after_lift_s:.2g} s"
    assert told["What happens while the beam rings?"].startswith(
        f"After a sudden touch it rings for up to {times}, if its damping is as assumed. Answers come all the same"
    )
    stated = resolve(change_scene(BENCH, beam={"damping_ratio": 0.05}))
    assert " s. Answers come" in answers(stated, model_of().metadata)["What happens while the beam rings?"]
    silent = resolve(change_scene(BENCH, beam={"density_kg_m3": None}))
    still = answers(silent, model_of().metadata)["What happens while the beam rings?"]
    assert still == "Nobody knows: the scene does not state the mass of the beam."


def test_drift_is_told_with_its_rate_and_how_long_it_takes(surface: Surface) -> None:
    """Half of the least deflection of a sensor that moves by 0.04 mm/N at most under 1 N: 20 um."""
    rows = [[0.01, 0.05, 0.04], [0.03, 0.02, 0.04], [0.01, 0.01, 0.01], [0.02, 0.05, 0.01]]
    drifting = replace(surface, readings=replace(surface.readings, drift_mm_per_min=0.004, zero_mm=1e-4, warmth_mm=0.0))
    told = answers(drifting, metadata_with([[2 * value for value in row] for row in rows]))["What if it warms?"]
    assert told == (
        "Zeros that drift by 4 µm a minute are followed whenever nothing touches the beam, until they are 30 µm "
        "from the last tare; then the note `zeros` asks for another. Drift in one direction takes at least 7.5 minutes "
        "to get there. While a contact lasts, its interval widens. "
        "Keep heat from one side away: a beam that is warmer above than below bows."
    )
    still = replace(surface, readings=replace(surface.readings, drift_mm_per_min=0.0))
    assert answers(still, model_of().metadata)["What if it warms?"] == (
        "It is taken not to matter: the zeros of the sensors do not drift. "
        "Keep heat from one side away: a beam that is warmer above than below bows."
    )


def settled(kind: str, readings: list[int], window: int = 4) -> Metadata:
    metadata = model_of().metadata
    since = [
        SinceTouch(since_ms=5.0 * count, readings=count, error_percent=1, error_standard_error=0.1)
        for count in readings
    ]
    chosen = FilterChoice(kind=kind, window=window, longest=200 if kind == "growing-mean" else None, spike_mm=0.1)  # type: ignore[arg-type]
    accuracy = metadata.accuracy.model_copy(update={"since_touch": since})
    return metadata.model_copy(update={"accuracy": accuracy, "filter": chosen})


def test_what_a_surface_can_do_is_told_with_its_times() -> None:
    told = can(settled("growing-mean", [2, 4, 16]), Measurement(0.5123, 0.0345))
    assert told[:3] == [
        "It answers 10 ms after a touch, and the answer sharpens while the load rests; 20 ms after the beam is still, "
        "it is as good as stated.",
        "It states the force, too: off by 0.51 N on average, where it is 1 to 20 N.",
        "It goes on with 1 of 3 sensors failed, less accurately.",
    ]
    assert told[3].startswith("While nothing touches, it states a contact that is not there: ")
    plain = can(settled("moving-average", [4, 16]), None)
    assert plain[0] == "It answers 20 ms after a touch."
    assert len(plain) == 3
    early = can(settled("moving-average", [2, 3]), None)
    assert early[0] == "It answers 10 ms after a touch."


def test_what_a_surface_cannot_do_is_told() -> None:
    assert cannot(model_of().metadata)[-2:] == [
        "It finds one contact. It gives no place for two at once, and not the shape of a load that is spread.",
        "It is no safety device: do not let it stop a machine that could hurt someone.",
    ]
    fragile = cannot(model_of(channels=3, min_channels=3).metadata)
    assert "It does not go on when a sensor fails: every one of them must work." in fragile
    assert len(fragile) == len(cannot(model_of().metadata)) + 1


def test_how_far_a_structure_bends_and_slopes_is_told(surface: Surface) -> None:
    """F l^3 / (48 E I) in the middle, and 0.06415 F l^2 / (E I) at an end under a load at 0.4226 of the length."""
    bent_mm, slope = 20 * 400**3 / (48 * 1.18125e7), 0.06415 * 20 * 400**2 / 1.18125e7
    yours = "forces, which count twice, fatigue, holes and fastening are yours to check."
    told = answers(surface, model_of().metadata)["Is the beam strong enough?"]
    assert told.endswith(f"It bends by up to {bent_mm:.3g} mm and slopes by up to {slope:.2g} rad. Sudden {yours}")
    moved = replace(surface.travel, lift_mm=1.23456, fall_mm=0.7, slope=0.0067891)
    plate = replace(surface, scene=read_scene(SCENES / "plate-on-springs.toml"), travel=moved)
    told = answers(plate, model_of(outputs=PLATE_OUTPUTS).metadata)["Is the plate strong enough?"]
    assert told == (
        "It moves by up to 1.23 mm and slopes by up to 0.0068 rad. "
        f"Its stress depends on how wide the contact is: that, sudden {yours}"
    )


@pytest.mark.parametrize(("verdict", "is_told"), [("not modelled", True), ("not stated", True), ("out", False)])
def test_a_beam_that_cannot_lengthen_is_told_as_far_as_that_counts(
    surface: Surface, verdict: Verdict, *, is_told: bool
) -> None:
    others = (Effect("shear", 0.01, "out", "thin"), Effect("expansion", 0.5, verdict, "it is held at both ends"))
    told = answers(replace(surface, effects=others), model_of().metadata)["What if it warms?"]
    assert ("The beam cannot lengthen freely: it is held at both ends. Keep heat from one side away" in told) == is_told
