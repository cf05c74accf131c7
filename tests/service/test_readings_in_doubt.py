"""What doubt of a sample does to events, channels and the door: unsteady figures, huge deflections, huge noise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface
from service.event_story import BETWEEN, RESTING, TOUCHING, Row

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from beamtouch_models.modelfile import Answers
    from beamtouch_service.samples import Batch
    from service.conftest import Bench, BuildModel, MakeBatch

    ParseBatch = Callable[..., Batch]

PRESSING: Row = [1.0, 0.5, 0.25]
STILL, MOVING = 1e-4, 0.01
"""Variance of a deflection [mm^2]; the model was made for the first."""


def stated(make_batch: MakeBatch, *rows: tuple[Row, float], sequence: int = 1) -> dict[str, Any]:
    """One batch of samples that state the variance of their deflections."""
    body = make_batch(*[row for row, _ in rows], sequence=sequence)
    for sample, (row, variance_mm2) in zip(body["samples"], rows, strict=True):
        channels = range(len(row))
        sample["covariance_mm2"] = [variance_mm2 * (i == j) for i in channels for j in range(i + 1)]
        sample["readings"] = 1
    return body


@pytest.mark.parametrize("parts", [[7], [2, 5], [3, 4], [4, 3], [1, 6]])
def test_unsteady_samples_count_in_no_peak_and_no_mean_if_there_are_others(
    bench: Bench, make_batch: MakeBatch, parts: list[int]
) -> None:
    rows = [(RESTING, STILL), (PRESSING, MOVING), *[(TOUCHING, STILL)] * 2, *[(PRESSING, MOVING)] * 2, (RESTING, STILL)]
    first = 0
    for count in parts:
        bench.post(stated(make_batch, *rows[first : first + count], sequence=first + 1))
        bench.get("/events")  # It writes what there is so far.
        first += count

    (event,) = bench.get("/events").json()["events"]
    assert (event["samples"], event["peak_force_n"], event["peak_position_mm"]) == (2, 8.75, 150.0)
    assert event["mean_position_mm"] == 150.0


def test_if_all_samples_are_unsteady_they_give_peak_and_mean(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(stated(make_batch, (RESTING, STILL), (TOUCHING, MOVING), (PRESSING, MOVING), (RESTING, STILL)))

    (event,) = bench.get("/events").json()["events"]
    assert (event["samples"], event["peak_force_n"], event["mean_position_mm"]) == (2, 17.5, 175.0)


def test_a_contact_that_is_held_on_a_weak_sample_says_so(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch(RESTING, TOUCHING, sequence=1))
    assert bench.get("/contact").json()["notes"] == []

    bench.post(make_batch(BETWEEN, sequence=3))
    held = bench.get("/contact").json()
    assert (held["state"], held["notes"], held["sequence"], held["misfit"]) == ("contact", ["unsteady"], 3, 0.0)

    bench.post(make_batch(RESTING, sequence=4))
    clear = bench.get("/contact").json()
    assert (clear["state"], clear["notes"], clear["position_mm"]) == ("clear", [], None)


def test_after_a_gap_nothing_is_known_of_the_samples_before(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch(RESTING, TOUCHING, TOUCHING, sequence=1))
    bench.post(make_batch(BETWEEN, sequence=5))
    weak = bench.get("/contact").json()
    assert (weak["state"], weak["notes"], weak["sequence"]) == ("clear", ["unsteady"], 5)

    bench.post(make_batch(TOUCHING, sequence=6))
    shown = bench.get("/contact").json()
    assert (shown["state"], shown["notes"], shown["position_mm"]) == ("contact", [], 150.0)


@pytest.mark.parametrize("huge_mm", [1e3, -1e3, 1e9, 1e38, -1e300])
def test_a_deflection_that_no_load_makes_is_out_of_range(bench: Bench, make_batch: MakeBatch, huge_mm: float) -> None:
    # The largest deflection of the model is 1 mm.
    bench.post(make_batch([0.5, 0.25, huge_mm], sequence=1))
    found = bench.get("/contact").json()
    assert (found["state"], found["degraded_channels"]) == ("contact", ["s3"])

    bench.post(make_batch([huge_mm] * 3, sequence=2))
    problem = bench.get("/contact").json()
    assert (problem["type"], problem["bad_channels"]["s1"]) == (
        "urn:beamtouch:problem:too-few-channels",
        "out-of-range",
    )


@pytest.mark.parametrize("noise_mm", [1.001e4, 1e155, 1e300])
def test_noise_that_no_channel_can_have_is_refused(bench: Bench, make_batch: MakeBatch, noise_mm: float) -> None:
    refused = bench.post(make_batch(sequence=1) | {"noise_mm": [0.01, noise_mm, 0.01]})
    assert refused.status_code == 422
    assert [one["pointer"] for one in refused.json()["errors"]] == ["#/noise_mm/1"]
    assert bench.post(make_batch(sequence=1) | {"noise_mm": [1e4] * 3}).status_code == 200
    assert bench.get("/contact").status_code == 200


@pytest.mark.parametrize("variance_mm2", [1.001e8, 1e12, 1e300])
def test_a_covariance_that_no_channel_can_have_is_refused(
    bench: Bench, make_batch: MakeBatch, variance_mm2: float
) -> None:
    body = make_batch(sequence=1)
    body["samples"][0] |= {"readings": 1, "covariance_mm2": [variance_mm2] * 6}
    refused = bench.post(body)
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["pointer"] == "#/samples/0/covariance_mm2/0"
    # The largest that is accepted is singular, and gives an answer.
    body["samples"][0] |= {"covariance_mm2": [1e8] * 6}
    assert bench.post(body).status_code == 200
    assert bench.get("/contact").status_code == 200


def test_a_covariance_that_rounding_makes_unusable_costs_only_its_own_sample(
    bench: Bench, make_batch: MakeBatch
) -> None:
    # An eigenvalue of -2e-4 mm^2 beside one of 3e6 passes for rounding, and is more than the floor makes up for.
    large, above = 1e6, 1e6 * (1 + 2e-10)
    unusable = {"readings": 1, "covariance_mm2": [large, above, large, above, above, large]}
    body = make_batch(RESTING, TOUCHING, TOUCHING, sequence=1)
    body["samples"][1] |= unusable
    assert bench.post(body).status_code == 200
    found = bench.get("/contact").json()
    assert (found["state"], found["sequence"]) == ("contact", 3)

    body = make_batch(TOUCHING, sequence=4)
    body["samples"][0] |= unusable
    assert bench.post(body).status_code == 200
    problem = bench.get("/contact")
    assert (problem.status_code, problem.json()["type"]) == (503, "urn:beamtouch:problem:unusable-estimate")
    assert problem.json()["detail"] == "For the newest sample, covariance_mm2: it must be positive definite."


def test_channels_are_left_out_only_as_often_as_needed(build_model: BuildModel, parse_batch: ParseBatch) -> None:
    rows = list[int]()

    class Counted(modelfile.ModelFile):
        def run(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
            rows.append(len(deflection_mm))
            return super().run(deflection_mm, whitening_per_mm)

    surface = Surface("press-7", Counted(**vars(modelfile.load(build_model(channels=4)))))
    surface.receive(parse_batch(*[[0.5, 0.25, 0.75, 0.125]] * 2000), arrival_s=10.0)

    contact = surface.contact(10.0)
    assert (contact.state, contact.notes) == (modelfile.State.UNEXPLAINED, ["check-s3"])
    # Four rows for each of the first samples, and for one in twenty of the others.
    assert sum(rows) <= 2000 + 4 * 450


def test_a_channel_that_drops_out_is_not_named_any_more(
    make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch
) -> None:
    bench = make_bench(Surface("press-7", modelfile.load(build_model(channels=4))))
    wedged, two = [0.5, 0.25, 0.75, 0.125], [0.5, 0.25, 0.75, None]
    quality = ["good", "good", "good", "missing"]
    notes = []
    for part in (make_batch(*[wedged] * 60), make_batch(*[two] * 3, sequence=61, quality=quality)):
        assert bench.post(part).status_code == 200
        notes.append(bench.get("/contact").json()["notes"])
    assert notes == [["check-s3"], []]
