"""The sample of each contact that is kept for a calibration."""

import csv
import dataclasses
import io
from typing import Any

import pytest

from service.bench import Bench, Row, surface_of, surface_with
from service.event_story import MOVING, RESTING, STILL, TOUCHING, send
from support.surfaces.small_model import model_of


def best_samples(bench: Bench, query: str = "") -> list[dict[str, str]]:
    answer = bench.get(f"/surfaces/press-7/calibration-data{query}")
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith("text/csv")
    return list(csv.DictReader(io.StringIO(answer.text)))


@pytest.mark.promise("docs/reference/loads.md", "the same of the rest before the contact")
def test_the_steady_sample_of_the_most_readings_is_kept_with_the_rest_before_it(bench: Bench) -> None:
    degraded = {"readings": 100, "quality": ["good", "good", "stuck"]}
    best: Row = [0.52, 0.26, 0.13]
    later: Row = [0.54, 0.27, 0.135]
    send(
        bench,
        *[([0.002, 0.0, 0.0], STILL), ([0.004, 0.0, 0.0], STILL), ([0.09, 0.0, 0.0], STILL), (TOUCHING, STILL)],
        *[(best, {"readings": 16}), (later, {"readings": 16}), (later, MOVING), (later, degraded), (RESTING, STILL)],
    )
    (row,) = best_samples(bench)
    assert [float(row[f"s{i}_mm"]) for i in (1, 2, 3)] == best
    assert [float(row[f"s{i}_sd_mm"]) for i in (1, 2, 3)] == pytest.approx([0.01 / 4] * 3)
    assert (row["readings"], row["characteristic"], row["time"]) == ("16", "as-taken", "2026-11-20T23:40:00.500Z")
    # Without the newest sample of the rest, which may hold the touch.
    assert [float(row[f"s{i}_rest_mm"]) for i in (1, 2, 3)] == pytest.approx([0.003, 0.0, 0.0])
    assert float(row["s1_rest_sd_mm"]) == pytest.approx(0.01 / 8**0.5, rel=1e-3)
    assert best_samples(bench, "?since=2026-11-20T23:40:01Z") == []


@pytest.mark.promise(
    "docs/reference/loads.md",
    (
        "the best sample of each contact that a single contact explains, which is the steady one with the most "
        "readings and all channels good"
    ),
)
def test_an_event_without_a_steady_sample_of_one_contact_has_no_row(bench: Bench) -> None:
    missing: dict[str, Any] = {"readings": 4, "quality": ["good", "missing", "good"]}
    odd: Row = [0.5, 0.1, 0.4]
    send(bench, (RESTING, STILL), (TOUCHING, MOVING), (TOUCHING, missing), (RESTING, STILL))
    send(bench, (RESTING, STILL), *[(odd, STILL)] * 6, *[(RESTING, STILL)] * 3, sequence=5)
    assert [event["kind"] for event in bench.get("/events").json()["events"]] == ["unexplained", "contact"]
    assert best_samples(bench) == []
    # A sender that states no readings sends settled samples.
    bench.send(RESTING, TOUCHING, RESTING, boot_id="boot-0002")
    (row,) = best_samples(bench)
    assert (row["readings"], row["characteristic"], row["s1_sd_mm"]) == ("1", "", "0.0100000000")


def test_the_rest_before_a_contact_is_known_less_well_the_longer_ago_it_was_if_zeros_drift() -> None:
    """Samples are 100 ms apart, in which the zeros of this model walk by 0.01 mm."""
    model = model_of()
    floor = model.metadata.floor.model_copy(update={"drift_mm_per_min": 6.0})
    metadata = model.metadata.model_copy(update={"floor": floor})
    bench = Bench(surface_with(dataclasses.replace(model, metadata=metadata)))
    best: Row = [0.52, 0.26, 0.13]
    send(bench, (RESTING, STILL), (RESTING, STILL), (TOUCHING, STILL), (best, {"readings": 16}), (RESTING, STILL))
    (row,) = best_samples(bench)
    # The rest has 4 readings, each of 0.01 mm, and the best sample is 200 ms after its end.
    assert float(row["s1_rest_sd_mm"]) == pytest.approx((0.005**2 + 0.02**2) ** 0.5, rel=1e-3)
    assert [float(row[f"s{number}_mm"]) for number in (1, 2, 3)] == best


def test_of_samples_with_as_many_readings_the_first_of_a_contact_is_the_best(bench: Bench) -> None:
    few, first, second = ([0.5 + step, 0.25, 0.125] for step in (0.0, 0.01, 0.02))
    send(bench, (RESTING, STILL), (few, {"readings": 15}), (first, {"readings": 16}), (second, {"readings": 16}))
    send(bench, (RESTING, STILL), sequence=5)
    (row,) = best_samples(bench)
    assert (float(row["s1_mm"]), row["readings"]) == (0.51, "16")


def test_a_contact_is_better_than_what_none_explains_however_many_readings_that_has(bench: Bench) -> None:
    odd: Row = [0.5, 0.25, 0.75]
    send(bench, (RESTING, STILL), (TOUCHING, {"readings": 2}), *[(odd, {"readings": 50})] * 5, (TOUCHING, STILL))
    send(bench, *[(RESTING, STILL)] * 6, sequence=9)
    (row,) = best_samples(bench)
    assert float(row["s3_mm"]) == 0.125


@pytest.mark.promise(
    "docs/how-to/spare-part.md",
    "Contacts from before the change do not help a calibration without loads",
)
def test_contacts_of_another_layout_of_channels_have_no_row() -> None:
    bench = Bench(surface_of(channels=4))
    send(bench, *(([*row, 0.0], STILL) for row in (RESTING, TOUCHING, RESTING)))
    assert list(best_samples(bench)[0])[5:9] == ["s1_mm", "s2_mm", "s3_mm", "s4_mm"]
    bench.adopt(model_of("other"))
    send(bench, *((row, STILL) for row in (RESTING, TOUCHING, RESTING)), sequence=10)
    (row,) = best_samples(bench)
    assert row["model"].startswith("other@")
    assert "s4_mm" not in row


@pytest.mark.parametrize(("reading_mm", "readings"), [(0.025, "6"), (0.005, "1"), (0.03, "9")])
def test_a_sample_without_readings_has_as_many_as_a_settled_one(reading_mm: float, readings: str) -> None:
    """The square of how many times the noise of a reading is that of a sample, 0.01 mm: averaging takes so many."""
    model = model_of()
    noise = model.metadata.noise.model_copy(update={"reading_mm": reading_mm})
    metadata = model.metadata.model_copy(update={"noise": noise})
    bench = Bench(surface_with(dataclasses.replace(model, metadata=metadata)))
    bench.send(RESTING, TOUCHING, TOUCHING, RESTING)
    (row,) = best_samples(bench)
    assert row["readings"] == readings
