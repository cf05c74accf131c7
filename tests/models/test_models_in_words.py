"""A model file in words: every line of a model in full, and where the smallest force of its scene is not seen."""

from typing import Any

import pytest

from beamtouch_models.runtime import Metadata
from beamtouch_models.runtime.departures import Calibration, Departures
from beamtouch_models.runtime.description import answers, extremes, lacking, nothing_seen, summary, unseen
from beamtouch_models.runtime.metadata_parts import (
    Accuracy,
    DrawnSupport,
    FilterChoice,
    Floor,
    LayoutErrors,
    Noise,
    Ranges,
    Sensor,
    SinceTouch,
    SmallestForce,
    Thresholds,
)
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

ACCURACY = Accuracy(
    error_percent=2.6,
    error_standard_error=0.1,
    limit_percent=2.0,
    limit_standard_error=0.06,
    ratio_standard_error=0.04,
    since_touch=[
        SinceTouch(since_ms=15.0, readings=3, error_percent=4.0, error_standard_error=0.1, ringing_percent=5.125),
        SinceTouch(since_ms=122.6, readings=9, error_percent=3.0, error_standard_error=0.1),
    ],
)
CALIBRATION = Calibration(
    departures=Departures.none(3),
    fitted=["gain", "rigidity"],
    loads=11,
    residual_mm=0.001,
    error_before_mm=12.34,
    error_after_mm=1.567,
    contacts=29,
    misfit_before=45.67,
    misfit_after=2.345,
)
BEAM: dict[str, Any] = {
    "length_mm": 640.0,
    "max_deflection_mm": 1.2345,
    "ranges": Ranges(position_mm=(2.5, 617), force_n=(2, 15)),
    "noise": Noise(reading_mm=0.0123, sample_mm=0.0045),
    "filter": FilterChoice(kind="growing-mean", window=7, longest=150),
    "sensor": Sensor(rate_hz=250, range_mm=(1.5, 4), standoff_mm=3.256, adc_bits=10, gain_mm_per_count=1, offset_mm=0),
    "floor": Floor(gain=[0.0123, 0.02, 0.0234], zero_mm=[0.0011, 0.0028, 0.002]),
    "thresholds": Thresholds(touch=[9.0] * 3, rest=[9.0] * 3, misfit=[9.0] * 3, false_contacts_per_day=1 / 7),
    "placed": LayoutErrors(
        criterion="eigenvalue-product",
        failed_percent=12.5,
        limit_without_percent=[3.0, 5.0, 4.0],
        limit_without_standard_error=[0.1, 0.3, 0.2],
    ),
    "smallest_force": SmallestForce(position_mm=[2.5, 300, 617], force_n=[2.345, 0.4321, None]),
    "accuracy": ACCURACY,
    "calibration": CALIBRATION,
    "seed": 17,
}


def beam(**parts: object) -> Metadata:
    return model_of().metadata.model_copy(update=BEAM | parts)


def told(metadata: Metadata, outputs: tuple[str, ...] = model_of().outputs) -> dict[str, str]:
    """Return what each line says, by its first word, on one line."""
    found: dict[str, str] = {}
    for line in summary(metadata, "press-7@123456", outputs).splitlines():
        first, rest = line.split(maxsplit=1)
        if line.startswith(" "):
            found[list(found)[-1]] += f" {' '.join(line.split())}"
        else:
            found[first] = f"{found[first]} / {rest}" if first in found else rest
    return found


def test_a_calibrated_beam_is_told_in_full() -> None:
    assert told(beam(), model_of().outputs) == {
        "model": "press-7@123456, estimator tiny, seed 17",
        "beam": "640 mm long, bends by up to 1.23 mm; identity beam-1",
        "sensors": "s1 100, s2 200, s3 300 mm from the left end; at least 2 must work",
        "mounted": "fixed_mm = [100.0, 200.0, 300.0] in [sensors] keeps them there",
        "contact": "from 2.5 to 617 mm, with 2 to 15 N, not known in advance",
        "error": "16.6 +- 0.6 mm on average (2.6 % of the length), with 7 readings of a load at rest",
        "limit": "12.8 +- 0.4 mm, the best possible with these sensors; error over limit 1.30 +- 0.04",
        "answer": "sudden touch: off by 33 mm at 15 ms / gentle touch: off by 26 mm at 15 ms, 19 mm at 123 ms",
        "failed": "the limit grows to 32 +- 2 mm if s2 fails, the worst to lose",
        "placed": "for the largest product of eigenvalues, as in the paper, with the worst sensor failed 12.5 % of the "
        "time",
        "touch": "smallest force seen: 0.43 N at the best place, 2.3 N and nothing at the ends",
        "rest": "false contacts while nothing touches: one in 7 days",
        "sensor": "linear over gaps of 1.5 to 4 mm, 3.26 mm at rest; 10 bits, 250 readings a second",
        "noise": "12.3 um per reading, 4.5 um per sample",
        "filter": "growing-mean of 7 to 150 readings",
        "floor": "gains +- 1.2..2.3 %, zeros +- 1.1..2.8 um, which no filter averages away",
        "outputs": "position_mm, position_low_mm, position_high_mm, contact_log_odds, misfit, force_n, force_low_n, "
        "force_high_n",
        "checked": "the graph gives the 2 answers that were stored with it",
        "fitted": "to the real beam, with 11 loads, mean error 12.3 mm before, 1.57 mm after; then with 29 unlabelled "
        "contacts, median misfit 45.7 before, 2.35 after; departures: gain, rigidity",
        "+-": "a standard error; in `floor`, a standard deviation",
    }


@pytest.mark.parametrize(
    ("parts", "name", "line"),
    [
        ({"ranges": Ranges(position_mm=(1, 2), force_n=(9.5, 10.5))}, "contact", "with 9.5 to 10.5 N, known to be wi"),
        ({"ranges": Ranges(position_mm=(1, 2), force_n=(10, 10))}, "contact", "with 10 N, an exact force"),
        ({"filter": FilterChoice(kind="moving-average", window=7, longest=None)}, "filter", "average of 7 readings"),
        ({"filter": FilterChoice()}, "error", "16.6 +- 0.6 mm on average (2.6 % of the length)"),
        ({"floor": Floor(gain=[0.02] * 3, zero_mm=[0.0015] * 3)}, "floor", "gains +- 2 %, zeros +- 1.5 um, "),
        ({"calibration": CALIBRATION.model_copy(update={"fitted": []})}, "fitted", "departures: no departures"),
        (
            {"calibration": CALIBRATION.model_copy(update={"error_before_mm": None})},
            "fitted",
            "to the real beam, with 29 unlabelled contacts, median misfit 45.7 before, 2.35 after; departures: gain, ",
        ),
        (
            {"calibration": CALIBRATION.model_copy(update={"misfit_after": None})},
            "fitted",
            "to the real beam, with 11 loads, mean error 12.3 mm before, 1.57 mm after; departures: gain, rigidity",
        ),
    ],
)
def test_what_differs_from_model_to_model_is_told(parts: dict[str, object], name: str, line: str) -> None:
    assert line in told(beam(**parts))[name]


def test_what_a_model_does_not_have_is_not_told() -> None:
    bare = told(beam(calibration=None, placed=BEAM["placed"].model_copy(update={"limit_without_percent": []})))
    assert not {"fitted", "failed", "placed", "lacks"} & bare.keys()
    assert "mounted" not in told(beam(scene="[measured]\n"))
    accuracy = ACCURACY.model_copy(update={"since_touch": ACCURACY.since_touch[1:]})
    assert list(answers(beam(accuracy=accuracy))) == ["gentle touch"]
    kept = ("position_mm", "position_high_mm", "contact_log_odds")
    assert lacking(beam(), kept) == ["position_low_mm", "misfit"]
    assert told(beam(), kept)["lacks"] == (
        "position_low_mm, misfit: `design-sensors evaluate` can use it, the service cannot"
    )


def test_a_plate_whose_sensors_show_no_gap_is_told_in_its_own_words() -> None:
    plate = model_of(channels=4, outputs=PLATE_OUTPUTS).metadata
    in_kpa = [channel.model_copy(update={"unit": "kPa"}) for channel in plate.layout]
    smallest = SmallestForce(position_mm=[1.0, 399, 200], across_mm=[1.0, 299, 150], force_n=[2.345, 0.4321, 1.0])
    lines = told(plate.model_copy(update={"layout": in_kpa, "accuracy": ACCURACY, "smallest_force": smallest}))
    assert lines["plate"] == "400 by 300 mm, shows up to 1 kPa; identity beam-1"
    assert lines["sensors"].endswith(" mm from the corner; at least 2 must work")
    assert "mounted" not in lines
    assert lines["contact"].startswith("from 1 to 399 mm and from 1 to 299 mm, with 1 to 20 N")
    # Of a diagonal of 500 mm.
    assert lines["error"] == "13.0 +- 0.5 mm on average (2.6 % of the diagonal)"
    assert lines["limit"].startswith("10.0 +- 0.3 mm, ")
    assert lines["answer"].startswith("sudden touch: off by 26 mm at 15 ms")
    assert lines["sensor"].startswith("linear over values of 1 to 4 kPa, 3 kPa at rest")
    assert lines["floor"].startswith("gains +- 0.3 %, zeros +- 0.002 kPa")
    assert lines["touch"] == "smallest force seen: 0.43 N at the best place, 2.3 N at the worst"
    blind = smallest.model_copy(update={"force_n": [2.345, None, 1.0]})
    lines = told(plate.model_copy(update={"smallest_force": blind}))
    assert lines["touch"] == "smallest force seen: 1 N at the best place, nothing at the worst"


@pytest.mark.parametrize(
    ("forces_n", "least_and_most"),
    [
        ([0.7, 0.3, 0.5], (0.3, 0.7)),
        ([0.7, None, 0.5], (0.5, None)),
        ([None, None], (None, None)),
    ],
)
def test_nothing_seen_is_more_than_any_force(
    forces_n: list[float | None], least_and_most: tuple[float | None, float | None]
) -> None:
    assert extremes(forces_n) == least_and_most


SUPPORTS = [DrawnSupport(at_mm=at_mm, kind="simple", slides=False) for at_mm in (0.0, 301.25, 640.0)]
MISSED = "the scene's smallest force, 2 N, is missed in more than 5 % of samples at "


def seen(forces_n: dict[float, float | None]) -> Metadata:
    """Return a beam with contacts from 0 to 640 mm of 2 N or more, and what is seen of them."""
    smallest = SmallestForce(position_mm=list(forces_n), force_n=list(forces_n.values()))
    drawn = model_of().metadata.drawn.model_copy(update={"supports": SUPPORTS})
    return beam(smallest_force=smallest, drawn=drawn, ranges=Ranges(position_mm=(0, 640), force_n=(2, 15)))


@pytest.mark.parametrize(
    ("forces_n", "missed", "nothing"),
    [
        ({0.0: 2.0, 100.0: 0.5, 640.0: 2.0}, "", ""),
        # A stretch at an end is told if it is more than 1.5 % of the range, 9.6 mm.
        ({0.0: 2.5, 9.5: 2.1, 20.0: 0.5}, "", ""),
        ({0.0: 2.5, 9.7: 2.1, 20.0: 0.5}, "0 to 9.7 mm: up to 2.5 N is needed there", ""),
        ({630.0: 0.5, 630.5: 2.25, 640.0: 3.0}, "", ""),
        ({630.0: 0.5, 630.25: 2.25, 640.0: 3.0}, "630 to 640 mm: up to 3 N is needed there", ""),
        # Any other is, too.
        ({0.0: 1.0, 100.0: 3.14, 120.0: 1.0}, "100 mm: up to 3.1 N is needed there", ""),
        ({0.0: 1.0, 100.0: 3.14, 103.0: 2.5, 120.0: 1.0}, "100 to 103 mm: up to 3.1 N is needed there", ""),
        (
            {0.0: 1.0, 100.0: 3.14, 120.0: 1.0, 130.0: 4.5, 140.0: 1.0},
            "100 mm and 130 mm: up to 4.5 N is needed there",
            "",
        ),
        # Where nothing is seen, the support is named, if there is one.
        ({0.0: None, 100.0: 1.0}, "0 mm: nothing is seen at the support at 0 mm", "the support at 0 mm"),
        ({299.0: 1.0, 301.25: None, 310.0: 1.0}, None, "the support at 301.2 mm"),
        ({299.0: None, 305.0: None, 310.0: 1.0}, None, "the support at 301.2 mm"),
        ({299.0: None, 301.0: None, 310.0: 1.0}, None, "299 to 301 mm"),
        (
            {0.0: 1.0, 50.0: None, 60.0: 1.0, 100.0: 5.25, 110.0: 1.0},
            "50 mm and 100 mm: nothing is seen at 50 mm, and up to 5.2 N is needed elsewhere",
            "50 mm",
        ),
        ({0.0: None, 20.0: 1.0, 50.0: None}, None, "the support at 0 mm and 50 mm"),
    ],
)
def test_where_the_smallest_force_of_a_beam_is_missed_and_where_nothing_is_seen(
    forces_n: dict[float, float | None], missed: str | None, nothing: str
) -> None:
    metadata = seen(forces_n)
    assert nothing_seen(metadata) == (f"nothing is seen at {nothing}" if nothing else "")
    if missed is not None:
        assert unseen(metadata) == (MISSED + missed if missed else "")


@pytest.mark.parametrize(
    ("forces_n", "said"),
    [
        ([2.0, 1.0, 0.5], ""),
        ([2.0, 1.0, 2.5], "33 % of the area of contacts: up to 2.5 N is needed there"),
        ([3.1, 1.0, 2.5], "67 % of the area of contacts: up to 3.1 N is needed there"),
        ([2.5, None, 1.0], "67 % of the area of contacts: nothing is seen on some of it"),
    ],
)
def test_where_the_smallest_force_of_a_plate_is_missed_is_told_by_the_share_of_its_area(
    forces_n: list[float | None], said: str
) -> None:
    smallest = SmallestForce(position_mm=[1.0, 2.0, 3.0], across_mm=[1.0, 2.0, 3.0], force_n=forces_n)
    ranges = Ranges(position_mm=(0, 400), across_mm=(0, 300), force_n=(2, 15))
    plate = model_of(channels=4, outputs=PLATE_OUTPUTS).metadata
    plate = plate.model_copy(update={"smallest_force": smallest, "ranges": ranges})
    assert unseen(plate) == (MISSED.removesuffix("at ") + f"on {said}" if said else "")
