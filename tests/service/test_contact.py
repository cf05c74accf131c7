"""What the model's answer comes to, over HTTP. Numbers by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface
from service.conftest import Bench, batch_of, kind

if TYPE_CHECKING:
    import httpx2

    from service.conftest import BuildModel

OUTPUTS = ("position_mm", "position_low_mm", "position_high_mm", "force_n", "force_low_n", "force_high_n")


def answer_of(bench: Bench, *row: float, **sample: object) -> httpx2.Response:
    """Send one sample and ask for the contact."""
    batch = batch_of(list(row))
    batch["samples"][0] |= sample
    assert bench.post(batch).status_code == 200
    return bench.get("/contact")


def figures(contact: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in contact.items() if name in OUTPUTS}


def test_a_contact_has_all_figures_rounded(bench: Bench) -> None:
    # The position is 100 + 100 s2 + 200 s3, the force 10 times the sum.
    assert figures(answer_of(bench, 0.5, 0.2345678, 0.0).json()) == {
        "position_mm": 123.4568,
        "position_low_mm": 122.4568,
        "position_high_mm": 124.4568,
        "force_n": 7.3457,
        "force_low_n": 6.3457,
        "force_high_n": 8.3457,
    }


@pytest.mark.parametrize("name", [*OUTPUTS, "contact_log_odds", "misfit"])
def test_what_is_not_finite_is_never_an_answer(build_model: BuildModel, name: str) -> None:
    bench = Bench(Surface("press-7", modelfile.load(build_model(spoiled=name))))
    problem = answer_of(bench, 1.0, 0.5, 0.5)
    assert kind(problem) == "unusable-estimate"
    assert f"{name} is not a finite number" in problem.json()["detail"]


@pytest.mark.parametrize(
    ("row", "position_mm"),
    [((0.5, 0.0, 0.0, 1.0), 400.0), ((0.5, 0.005, 0.0, 1.0), 400.5), ((0.9, 0.0, 0.0, -0.335), -0.5)],
)
def test_a_position_beyond_the_end_is_an_answer_while_its_interval_meets_the_beam(
    build_model: BuildModel, row: tuple[float, ...], position_mm: float
) -> None:
    bench = Bench(Surface("press-7", modelfile.load(build_model(channels=4))))
    assert answer_of(bench, *row).json()["position_mm"] == pytest.approx(position_mm, abs=1e-3)


@pytest.mark.parametrize(
    ("row", "detail"),
    [
        ((0.5, 0.02, 0.0, 1.0), "position_mm is 402, off a beam of 400 mm"),
        ((0.9, 0.0, 0.0, -0.4), "position_mm is -20, off a beam of 400 mm"),
    ],
)
def test_a_position_whose_interval_misses_the_beam_is_no_answer(
    build_model: BuildModel, row: tuple[float, ...], detail: str
) -> None:
    bench = Bench(Surface("press-7", modelfile.load(build_model(channels=4))))
    problem = answer_of(bench, *row)
    assert kind(problem) == "unusable-estimate"
    assert detail in problem.json()["detail"]


@pytest.mark.parametrize(
    ("unix_us", "sampled_at"),
    [
        (0, "1970-01-01T00:00:00.000Z"),
        (1_795_218_046_123_999, "2026-11-20T23:40:46.123Z"),
        (2**53 - 1, "2255-06-05T23:47:34.740Z"),
    ],
)
def test_times_are_rfc_3339_with_milliseconds(bench: Bench, unix_us: int, sampled_at: str) -> None:
    assert answer_of(bench, 0.5, 0.25, 0.125, acquired_unix_us=unix_us).json()["sampled_at"] == sampled_at
