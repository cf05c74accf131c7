"""The best sample of an event, as `calibration-data` gives it: by hand, on a model that is easy to compute."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any

import pytest

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface

if TYPE_CHECKING:
    from service.conftest import Bench, BuildModel, MakeBatch

REST, TOUCH = [0.0, 0.0, 0.0], [0.5, 0.25, 0.125]
STILL: dict[str, Any] = {"readings": 4}
MOVING: dict[str, Any] = {"readings": 50, "covariance_mm2": [1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3]}


def touched(make_batch: MakeBatch, *samples: tuple[list[float], dict[str, Any]], sequence: int = 1) -> dict[str, Any]:
    """A batch of these samples, 100 ms apart, each with its further members."""
    batch = make_batch(*(row for row, _ in samples), sequence=sequence)
    for place, (sample, (_, members)) in enumerate(zip(batch["samples"], samples, strict=True)):
        sample.update(members, acquired_unix_us=1_795_218_000_000_000 + (sequence + place) * 100_000)
    return batch | {"noise_mm": [0.01] * 3, "characteristic": "as-taken"}


def rows(bench: Bench) -> list[dict[str, str]]:
    answer = bench.get("/surfaces/press-7/calibration-data")
    assert answer.status_code == 200, answer.text
    return list(csv.DictReader(io.StringIO(answer.text)))


def test_the_steady_sample_of_the_most_readings_is_kept_with_the_rest_before_it(
    bench: Bench, make_batch: MakeBatch
) -> None:
    degraded = {"readings": 100, "quality": ["good", "good", "stuck"]}
    best, later = [0.52, 0.26, 0.13], [0.54, 0.27, 0.135]
    samples = [
        ([0.002, 0.0, 0.0], STILL), ([0.004, 0.0, 0.0], STILL), ([0.09, 0.0, 0.0], STILL),
        (TOUCH, STILL), (best, {"readings": 16}), (later, {"readings": 16}), (later, MOVING), (later, degraded),
        (REST, STILL),
    ]  # fmt: skip
    bench.post(touched(make_batch, *samples))

    (row,) = rows(bench)
    assert [float(row[f"s{i}_mm"]) for i in (1, 2, 3)] == best
    assert [float(row[f"s{i}_sd_mm"]) for i in (1, 2, 3)] == pytest.approx([0.01 / 4] * 3)
    assert (row["readings"], row["characteristic"], row["time"]) == ("16", "as-taken", "2026-11-20T23:40:00.500Z")
    # Without the newest sample of the rest, which may hold the touch.
    assert [float(row[f"s{i}_rest_mm"]) for i in (1, 2, 3)] == pytest.approx([0.003, 0.0, 0.0])
    assert float(row["s1_rest_sd_mm"]) == pytest.approx(0.01 / 8**0.5)


def test_an_event_without_a_steady_sample_of_all_channels_has_no_row(bench: Bench, make_batch: MakeBatch) -> None:
    missing: dict[str, Any] = {"readings": 4, "quality": ["good", "missing", "good"]}
    bench.post(touched(make_batch, (REST, STILL), (TOUCH, MOVING), (TOUCH, missing), (REST, STILL)))

    assert len(bench.get("/events").json()["events"]) == 1
    assert rows(bench) == []


def test_a_sender_that_states_no_readings_sends_settled_samples(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch(REST, TOUCH, REST))

    (row,) = rows(bench)
    assert (row["readings"], row["characteristic"], row["s1_sd_mm"]) == ("1", "", "0.0100000000")


def test_samples_that_no_single_contact_explains_are_no_calibration_data(bench: Bench, make_batch: MakeBatch) -> None:
    odd = [0.5, 0.1, 0.4]
    bench.post(touched(make_batch, (REST, STILL), *[(odd, STILL)] * 6, (REST, STILL)))

    assert rows(bench) == []


def test_contacts_of_another_layout_of_channels_have_no_row(
    make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch
) -> None:
    surface = Surface("press-7", modelfile.load(build_model(channels=4)))
    bench = make_bench(surface)
    before = touched(make_batch, *(([*row, 0.0], STILL) for row in (REST, TOUCH, REST)))
    assert bench.post(before | {"noise_mm": [0.01] * 4}).status_code == 200
    assert list(rows(bench)[0])[5:9] == ["s1_mm", "s2_mm", "s3_mm", "s4_mm"]

    surface.adopt(modelfile.load(build_model(name="other", channels=3)))
    bench.post(touched(make_batch, *((row, STILL) for row in (REST, TOUCH, REST)), sequence=10))
    (row,) = rows(bench)
    assert row["model"].startswith("other@")
    assert "s4_mm" not in row
