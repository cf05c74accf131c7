"""What Prometheus is told."""

from __future__ import annotations

from typing import TYPE_CHECKING

from prometheus_client.parser import text_string_to_metric_families

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch


def scraped(bench: Bench) -> dict[tuple[str, ...], float]:
    response = bench.get("/metrics")
    assert response.status_code == 200
    assert response.headers["content-type"].startswith("text/plain; version=")
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(response.text)
        for sample in family.samples
    }


def test_before_anything_has_happened_nothing_is_counted(bench: Bench) -> None:
    found = scraped(bench)

    assert found["beamtouch_samples_accepted_total", "press-7"] == 0
    assert found["beamtouch_refusals_total", "unauthorized"] == 0
    assert found["beamtouch_event_writes_lost_total",] == 0
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
        ("beamtouch_contacts_total", "contact"): 4,
        ("beamtouch_contacts_total", "clear"): 1,
        ("beamtouch_problems_total", "no-samples"): 1,
        ("beamtouch_batches_rejected_total", "malformed-json"): 1,
        ("beamtouch_batches_rejected_total", "missing-channels"): 1,
        ("beamtouch_refusals_total", "unauthorized"): 1,
        ("beamtouch_inference_seconds_count", "press-7"): 3,
        ("beamtouch_model_refused", "press-7"): 0,
    }
    assert {name: found[name] for name in expected} == expected
    assert found["beamtouch_inference_seconds_sum", "press-7"] > 0
