"""What the service says of a candidate: `GET /surfaces/NAME/candidate` and the metrics."""

from typing import Any

from prometheus_client.parser import text_string_to_metric_families

from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.shadow import Shadow
from beamtouch_service.surfaces.surface import Surface
from service.bench import Bench, surface_of, surface_with
from service.event_story import RESTING, TOUCHING
from support.surfaces.small_model import model_of

OLD, NEW = model_of(), model_of("new", force_n_per_mm=12.0)


def staged() -> tuple[Bench, Surface]:
    """Return a surface with a candidate that says a fifth more force."""
    surface = surface_of()
    surface.shadow = Shadow(NEW, "press-7", SurfaceSection())
    return Bench(surface), surface


def candidate_of(bench: Bench) -> dict[str, Any]:
    answer = bench.get("/surfaces/press-7/candidate")
    assert answer.status_code == 200, answer.text
    said: dict[str, Any] = answer.json()
    return said


def metrics(bench: Bench) -> dict[str, float]:
    """Return the metrics of candidates, by name and the label beside the surface."""
    return {
        ".".join([sample.name, *(value for label, value in sample.labels.items() if label != "surface")]): sample.value
        for family in text_string_to_metric_families(bench.metrics())
        for sample in family.samples
        if "_candidate" in sample.name
    }


def test_without_a_candidate_there_is_nothing_to_compare() -> None:
    bench = Bench(surface_of())
    assert candidate_of(bench) == {"model": OLD.identity, "candidate": None, "error": None, "comparison": None}
    assert metrics(bench) == {"beamtouch_candidate_refused": 0}
    assert candidate_of(Bench(surface_with(None)))["model"] is None
    assert bench.problem("/surfaces/press-8/candidate") == "unknown-surface"


def test_a_candidate_is_told_with_all_that_differs() -> None:
    bench, _ = staged()
    bench.send(RESTING, TOUCHING)
    said = candidate_of(bench)
    assert (said["model"], said["candidate"], said["error"]) == (OLD.identity, NEW.identity, None)
    compared = said["comparison"]
    assert {name: compared[name] for name in ("samples", "differing", "contacts", "is_worse")} == {
        "samples": 2,
        "differing": 0,
        "contacts": 1,
        "is_worse": None,
    }
    assert compared["figures"]["force_n"]["mean"] == 1.75
    assert "the force differs by 1.75 N on average" in compared["verdict"]
    assert metrics(bench) == {
        f"beamtouch_candidate.{NEW.identity}": 1,
        "beamtouch_candidate_refused": 0,
        "beamtouch_candidate_samples_total": 2,
        "beamtouch_candidate_differing_total": 0,
        "beamtouch_candidate_difference.position_mm": 0,
        "beamtouch_candidate_difference.force_n": 1.75,
    }


def test_a_candidate_that_is_not_compared_is_told_with_the_reason() -> None:
    bench, surface = staged()
    assert surface.shadow
    surface.shadow.error = "the comparison has ended: it fails"
    assert candidate_of(bench)["error"] == "the comparison has ended: it fails"
    found = metrics(bench)
    assert (found[f"beamtouch_candidate.{NEW.identity}"], found["beamtouch_candidate_refused"]) == (0, 1)
    surface.shadow, surface.candidate_error = None, "damaged"
    assert (candidate_of(bench)["error"], candidate_of(bench)["comparison"]) == ("damaged", None)
    assert metrics(bench) == {"beamtouch_candidate_refused": 1}


def test_what_is_compared_answers_nothing() -> None:
    bench, _ = staged()
    bench.send(TOUCHING)
    assert (bench.contact()["model"], bench.contact()["force_n"]) == (OLD.identity, 8.75)
