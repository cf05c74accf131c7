"""The routes, with a clock that the tests turn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface
from service.conftest import kind

if TYPE_CHECKING:
    from beamtouch_service.problems import Problem
    from beamtouch_service.samples import Batch
    from beamtouch_service.surfaces.surface import Answer, Received
    from service.conftest import Bench, BuildModel, MakeBatch


def test_the_contact_is_the_one_of_the_design(bench: Bench, make_batch: MakeBatch) -> None:
    assert bench.post(make_batch(age_ms=12.3, sequence=4711)).json() == {
        "accepted": 1,
        "repeated": 0,
        "durable": 4710,
        "expected": 4712,
        "stale_ms": 500.0,
    }

    response = bench.get("/contact")
    assert response.status_code == 200
    assert response.headers["cache-control"] == "no-store"
    contact = response.json()
    assert str(contact.pop("model")).startswith("press-7@")
    assert contact == {
        "surface": "press-7",
        "state": "contact",
        "position_mm": 150.0,
        "position_low_mm": 149.0,
        "position_high_mm": 151.0,
        "force_n": 8.75,
        "force_low_n": 7.75,
        "force_high_n": 9.75,
        "age_ms": 12.3,
        "sampled_at": "2026-11-20T23:40:46.123Z",
        "sequence": 4711,
        "readings": None,
        "misfit": 0.0,
        "quality": "good",
        "degraded_channels": [],
        "notes": [],
    }
    assert bench.get("/surfaces/press-7/contact").json() == response.json()
    assert bench.get("/contact?surface=press-7").json() == response.json()


def test_a_note_of_the_sender_stands_with_the_contact_until_it_is_gone(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch() | {"notes": ["rate"]})
    assert bench.get("/contact").json()["notes"] == ["rate"]
    bench.post(make_batch(sequence=2))
    assert bench.get("/contact").json()["notes"] == []
    refused = bench.post(make_batch(sequence=3) | {"notes": ["loud"]})
    assert (refused.status_code, kind(refused)) == (422, "invalid-request")


def test_a_beam_at_rest_is_clear_and_has_no_position(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch([0.01, 0.02, 0.01]))

    contact = bench.get("/contact").json()
    assert contact["state"] == "clear"
    assert {contact[name] for name in contact if name.startswith(("position_", "force_"))} == {None}


def test_the_newest_sample_of_a_batch_counts(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch([0.5, 0.25, 0.125], [0.5, 0.5, 0.0]))

    assert bench.get("/contact").json()["position_mm"] == pytest.approx(150.0)
    assert bench.get("/contact").json()["sequence"] == 2


def test_no_samples_then_fresh_then_stale(bench: Bench, make_batch: MakeBatch) -> None:
    assert kind(bench.get("/contact")) == "no-samples"
    assert kind(bench.get("/health/ready")) == "not-ready"

    bench.post(make_batch())
    assert bench.get("/contact").status_code == 200
    assert bench.get("/health/ready").json() == {"status": "ready"}

    bench.now_s += 0.6
    stale = bench.get("/contact")
    assert (stale.status_code, kind(stale)) == (503, "stale")
    assert (stale.json()["surface"], stale.json()["age_ms"], stale.json()["stale_ms"]) == ("press-7", 600.0, 500.0)
    ready = bench.get("/health/ready")
    assert (ready.status_code, kind(ready)) == (503, "not-ready")
    assert ready.json()["surfaces"]["press-7"]["type"] == "urn:beamtouch:problem:stale"
    assert bench.get("/health/live").json() == {"status": "live"}


def test_too_few_channels_are_named(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch([0.5, None, 0.1], quality=["good", "missing", "stuck"]))

    response = bench.get("/contact")
    assert (response.status_code, kind(response)) == (503, "too-few-channels")
    assert response.json()["bad_channels"] == {"s2": "missing", "s3": "stuck"}


def test_an_unusable_estimate_is_a_problem_and_no_number(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch([1.0, 0.5, 0.5]))

    response = bench.get("/contact")
    assert (response.status_code, kind(response)) == (503, "unusable-estimate")
    assert "NaN" not in response.text


def test_a_service_without_a_surface_says_so_everywhere(make_bench: type[Bench], make_batch: MakeBatch) -> None:
    bench = make_bench()

    answers = [bench.get("/contact"), bench.get("/surfaces/press-7/contact"), bench.get("/health/ready")]
    for response in [*answers, bench.post(make_batch())]:
        assert (response.status_code, kind(response)) == (503, "no-surface")
    assert bench.get("/surfaces").json() == {"surfaces": []}
    assert bench.get("/health/live").status_code == 200


def test_a_surface_without_a_model_takes_samples_and_says_why_it_gives_nothing(
    make_bench: type[Bench], make_batch: MakeBatch
) -> None:
    bench = make_bench(Surface("press-7"))

    assert bench.post(make_batch([0.5], channels=["any"])).status_code == 200
    response = bench.get("/contact")
    assert (response.status_code, kind(response)) == (503, "no-model")


def test_several_surfaces_must_be_named(
    make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch
) -> None:
    model = modelfile.load(build_model())
    bench = make_bench(Surface("press-7", model), Surface("press-8", model))
    bench.post(make_batch(), path="/surfaces/press-8/samples")

    response = bench.get("/contact")
    assert (response.status_code, kind(response)) == (400, "surface-required")
    assert response.json()["surfaces"] == ["press-7", "press-8"]
    assert bench.get("/contact?surface=press-8").json()["surface"] == "press-8"
    assert kind(bench.get("/contact?surface=press-7")) == "no-samples"
    unready = bench.get("/health/ready").json()["surfaces"]
    assert list(unready) == ["press-7"]


@pytest.mark.parametrize(
    "path", ["/contact?surface=nobody", "/surfaces/nobody/contact", "/surfaces/nobody", "/surfaces/%C3%A9%00"]
)
def test_an_unknown_surface_is_404(bench: Bench, path: str) -> None:
    response = bench.get(path)

    assert (response.status_code, kind(response)) == (404, "unknown-surface")


def test_the_summary_of_a_surface(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch())

    summary = bench.get("/surfaces/press-7").json()
    assert bench.get("/surfaces").json() == {"surfaces": [summary]}
    assert str(summary.pop("model")).startswith("press-7@")
    assert summary == {
        "name": "press-7",
        "beam": "beam-1",
        "channels": ["s1", "s2", "s3"],
        "stale_ms": 500.0,
        "age_ms": 0.0,
        "state": "contact",
        "problem": None,
        "notes": [],
        "misfit": 0.0,
        "misfit_limit": 30.0,
        "channels_out": {},
        "wiring": None,
        "model_error": None,
        "samples": {"accepted": 1, "repeated": 0, "lost": 0},
        "health": {},
    }


@pytest.mark.parametrize("path", ["/nothing", "/page", "/contact/", "/docs", "/surfaces/a/b/c"])
def test_an_unknown_route_is_a_problem(bench: Bench, path: str) -> None:
    response = bench.get(path)

    assert (response.status_code, kind(response)) == (404, "not-found")


def test_a_wrong_method_is_a_problem_that_names_the_right_one(bench: Bench) -> None:
    response = bench.client.delete("/contact")

    assert (response.status_code, kind(response)) == (405, "method-not-allowed")
    assert response.headers["allow"] == "GET"


def test_a_failure_inside_is_a_problem_without_its_traceback(make_bench: type[Bench], make_batch: MakeBatch) -> None:
    class Broken(Surface):
        def answer(self, now_s: float) -> Answer | Problem:
            message = f"secret at {now_s}"
            raise RuntimeError(message)

        def receive(self, batch: Batch, arrival_s: float, address: str = "") -> Received:
            message = f"secret at {arrival_s} from {address} in {batch}"
            raise RuntimeError(message)

    bench = make_bench(Broken("press-7"))
    for response in (bench.get("/surfaces"), bench.post(make_batch())):
        assert (response.status_code, kind(response)) == (500, "internal")
        assert "secret" not in response.text
