"""What Prometheus is told."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from prometheus_client.parser import text_string_to_metric_families

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface

if TYPE_CHECKING:
    from collections.abc import Iterator

    from service.conftest import Bench, BuildModel, MakeBatch


def scraped(bench: Bench) -> dict[tuple[str, ...], float]:
    """Values by name and labels, the surface before the others."""
    response = bench.get("/metrics")
    assert response.status_code == 200
    assert response.headers["content-type"].startswith("text/plain; version=")
    return {
        (sample.name, *(sample.labels[label] for label in sorted(sample.labels, key=_surface_first))): sample.value
        for family in text_string_to_metric_families(response.text)
        for sample in family.samples
    }


def _surface_first(label: str) -> tuple[bool, str]:
    return label != "surface", label


def test_before_anything_has_happened_nothing_is_counted(bench: Bench) -> None:
    found = scraped(bench)

    assert found["beamtouch_samples_accepted_total", "press-7"] == 0
    assert found["beamtouch_refusals_total", "unauthorized"] == 0
    assert found["beamtouch_record_outages_total",] == 0
    assert found["beamtouch_contacts_total", "press-7", "clear"] == 0
    assert found["beamtouch_batch_seconds_count", "press-7"] == 0
    assert ("beamtouch_sample_age_seconds", "press-7") not in found


def test_samples_contacts_problems_and_durations(bench: Bench, make_batch: MakeBatch) -> None:
    bench.get("/contact")
    bench.post(make_batch(sequence=1))
    bench.post(make_batch(sequence=1))
    bench.post(make_batch(sequence=5))
    for path in ("/contact", "/contact?surface=press-7", "/surfaces/press-7/contact", "/contact?x=1"):
        assert bench.get(path).status_code == 200
    bench.post(make_batch([0.0, 0.0, 0.0], sequence=6))
    bench.get("/contact")
    bench.post(b"{")
    bench.post(make_batch([1.0], sequence=7))
    bench.post(make_batch(), token="wrong")  # noqa: S106  # it is wrong
    bench.now_s += 0.25

    found = scraped(bench)
    expected = {
        ("beamtouch_samples_accepted_total", "press-7"): 3,
        ("beamtouch_samples_repeated_total", "press-7"): 1,
        ("beamtouch_samples_missing", "press-7"): 3,
        ("beamtouch_sample_age_seconds", "press-7"): 0.25,
        ("beamtouch_sender_changes_total", "press-7"): 0,
        ("beamtouch_contacts_total", "press-7", "contact"): 4,
        ("beamtouch_contacts_total", "press-7", "clear"): 1,
        ("beamtouch_problems_total", "no-samples"): 1,
        ("beamtouch_batches_rejected_total", "press-7", "malformed-json"): 1,
        ("beamtouch_batches_rejected_total", "press-7", "missing-channels"): 1,
        ("beamtouch_refusals_total", "unauthorized"): 1,
        ("beamtouch_inference_seconds_count", "press-7"): 3,
        ("beamtouch_model_refused", "press-7"): 0,
    }
    assert {name: found[name] for name in expected} == expected
    assert found["beamtouch_inference_seconds_sum", "press-7"] > 0


def test_every_surface_has_counts_of_its_own(
    make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch
) -> None:
    model = modelfile.load(build_model())
    bench = make_bench(Surface("press-7", model), Surface("press-8", model))
    for name, sequence in (("press-7", 1), ("press-7", 2), ("press-8", 1)):
        bench.post(make_batch(sequence=sequence), path=f"/surfaces/{name}/samples")
    for path in ("/surfaces/press-7/contact", "/contact?surface=press-8", "/contact?surface=press-8&x=1"):
        assert bench.get(path).status_code == 200
    assert bench.get("/contact?surface=press-8").status_code == 200
    for name in ("press-8", "made-up", "made-up-too"):
        bench.post(b"{", path=f"/surfaces/{name}/samples")

    found = scraped(bench)
    contacts = {key[1:]: value for key, value in found.items() if key[0] == "beamtouch_contacts_total" and value}
    rejected = {key[1:]: value for key, value in found.items() if key[0] == "beamtouch_batches_rejected_total"}
    assert contacts == {("press-7", "contact"): 1, ("press-8", "contact"): 3}
    assert rejected == {("press-8", "malformed-json"): 1, ("", "unknown-surface"): 2}
    assert found["beamtouch_batch_seconds_count", "press-7"] == 2
    assert found["beamtouch_batch_seconds_count", "press-8"] == 1
    assert not [key for key in found if "made-up" in "".join(key)]


def test_how_long_a_batch_takes_and_how_old_its_samples_are_when_it_comes(bench: Bench, make_batch: MakeBatch) -> None:
    def slow_body(takes_s: float, **options: int) -> Iterator[bytes]:
        body = json.dumps(make_batch(**options)).encode()
        yield body[:-1]
        bench.now_s += takes_s
        yield body[-1:]

    assert bench.post(slow_body(0.3, sequence=2, age_ms=15)).status_code == 200
    # What comes late says nothing of how old the present is.
    assert bench.post(slow_body(0.0, sequence=1, age_ms=10**9)).status_code == 200

    found = scraped(bench)
    batches = {key[2]: value for key, value in found.items() if key[0] == "beamtouch_batch_seconds_bucket"}
    ages = {key[2]: value for key, value in found.items() if key[0] == "beamtouch_sample_arrival_age_seconds_bucket"}
    assert (batches["0.0005"], batches["0.2"], batches["0.5"], batches["+Inf"]) == (1, 1, 2, 2)
    assert (ages["0.01"], ages["0.02"], ages["+Inf"]) == (0, 1, 1)
    assert found["beamtouch_batch_seconds_sum", "press-7"] == pytest.approx(0.3)
    assert found["beamtouch_sample_arrival_age_seconds_sum", "press-7"] == pytest.approx(0.015)
