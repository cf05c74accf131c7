"""When a contact begins and ends, and what never moves it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.surface import Surface

if TYPE_CHECKING:
    from collections.abc import Callable

    from beamtouch_service.samples import Batch
    from service.conftest import Bench, BuildModel, MakeBatch

    ParseBatch = Callable[..., Batch]

TOUCHING, BETWEEN, RESTING = [0.5, 0.25, 0.125], [0.05, 0.0, 0.0], [0.0, 0.0, 0.0]


@pytest.fixture
def surface(build_model: BuildModel) -> Surface:
    return Surface("press-7", modelfile.load(build_model()))


def states(surface: Surface, batch: Batch, each: int) -> str:
    """The state after each sample of a batch, which arrives in parts of `each` samples."""
    found = ""
    for start in range(0, len(batch.samples), each):
        part = batch.model_copy(update={"samples": batch.samples[start : start + each]})
        surface.receive(part, arrival_s=10.0 + start / 1000)
        found += surface.contact(10.0 + start / 1000).state.value[1]
    return found


def test_a_load_at_the_threshold_gives_one_contact(surface: Surface, parse_batch: ParseBatch) -> None:
    rng = np.random.default_rng(1)
    rows = [[0.1 + float(noise), 0.0, 0.0] for noise in rng.normal(scale=0.02, size=1000)]
    found = states(surface, parse_batch(RESTING, *rows, RESTING), each=1)

    edges = found.replace("ol", "o l").replace("lo", "l o").split()
    assert [edge[0] for edge in edges] == ["l", "o", "l"]


def test_between_the_thresholds_the_state_is_what_it_was(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(BETWEEN, sequence=1), arrival_s=10.0)
    assert surface.contact(10.0).state.value == "clear"

    surface.receive(parse_batch(TOUCHING, BETWEEN, sequence=2), arrival_s=10.01)
    assert surface.contact(10.01).state.value == "contact"

    surface.receive(parse_batch(RESTING, BETWEEN, sequence=4), arrival_s=10.02)
    assert surface.contact(10.02).state.value == "clear"


def test_a_sample_without_an_answer_leaves_the_state(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(TOUCHING, sequence=1), arrival_s=10.0)
    surface.receive(parse_batch(RESTING, sequence=2, quality=["missing"] * 3), arrival_s=10.01)
    surface.receive(parse_batch(BETWEEN, sequence=3), arrival_s=10.02)

    assert surface.contact(10.02).state.value == "contact"


def test_after_a_long_gap_a_contact_must_begin_anew(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(TOUCHING, sequence=1), arrival_s=10.0)
    later = parse_batch(BETWEEN, sequence=900)
    sample = later.samples[0].model_copy(update={"acquired_unix_us": later.samples[0].acquired_unix_us + 600_000})
    surface.receive(later.model_copy(update={"samples": [sample]}), arrival_s=10.6)

    assert surface.contact(10.6).state.value == "clear"


def test_a_batch_is_answered_as_its_samples_one_by_one(surface: Surface, parse_batch: ParseBatch) -> None:
    batch = parse_batch(*[TOUCHING, BETWEEN, RESTING, BETWEEN] * 20)
    assert states(surface, batch, each=1) == "ooll" * 20
    again = Surface("press-7", surface.model)
    assert states(again, batch, each=2) == "ol" * 20


@pytest.mark.parametrize("sequence", [500, 1], ids=["before", "first"])
def test_an_hour_old_batch_changes_nothing(surface: Surface, parse_batch: ParseBatch, sequence: int) -> None:
    surface.receive(parse_batch(TOUCHING, sequence=1000), arrival_s=5000.0)
    before = surface.contact(5000.1)
    surface.receive(parse_batch(RESTING, RESTING, sequence=sequence, age_ms=3_600_000), arrival_s=5000.1)

    assert surface.contact(5000.1) == before


def test_a_newer_sample_that_is_an_hour_old_shows_that_the_present_was_older_still(
    surface: Surface, parse_batch: ParseBatch
) -> None:
    surface.receive(parse_batch(TOUCHING, sequence=1000), arrival_s=5000.0)
    surface.receive(parse_batch(RESTING, sequence=2000, age_ms=3_600_000), arrival_s=5000.1)

    problem = surface.unready(5000.1)
    assert problem is not None
    assert problem.kind is Kind.STALE


def test_a_batch_that_fills_a_gap_up_to_the_present_changes_nothing(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(TOUCHING, sequence=10), arrival_s=10.0)
    surface.receive(parse_batch(RESTING, RESTING, RESTING, sequence=8), arrival_s=10.1)

    assert (surface.contact(10.1).sequence, surface.contact(10.1).state.value) == (10, "contact")


def test_a_batch_over_the_present_moves_it_only_from_there_on(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(TOUCHING, sequence=10), arrival_s=10.0)
    surface.receive(parse_batch(RESTING, RESTING, RESTING, BETWEEN, sequence=8), arrival_s=10.1)

    assert (surface.contact(10.1).sequence, surface.contact(10.1).state.value) == (11, "contact")


def test_a_former_sender_does_not_move_a_fresh_present(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(RESTING, boot_id="boot-0001", sequence=7), arrival_s=10.0)
    surface.receive(parse_batch(TOUCHING, boot_id="boot-0002", sequence=1), arrival_s=10.1)
    # Its age is stated wrongly: as if it were taken just now.
    surface.receive(parse_batch(RESTING, boot_id="boot-0001", sequence=8), arrival_s=10.2)

    assert (surface.contact(10.2).sequence, surface.contact(10.2).state.value) == (1, "contact")


def test_readiness_says_which_surface_gives_no_answer(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch([0.5, None, 0.1], sequence=1, quality=["good", "missing", "stuck"]))
    response = bench.get("/health/ready")
    assert response.status_code == 503
    reason = response.json()["surfaces"]["press-7"]
    assert (reason["type"], reason["bad_channels"]["s3"]) == ("urn:beamtouch:problem:too-few-channels", "stuck")

    bench.post(make_batch([1.0, 0.5, 0.5], sequence=2))
    response = bench.get("/health/ready")
    assert response.json()["surfaces"]["press-7"]["type"] == "urn:beamtouch:problem:unusable-estimate"

    bench.post(make_batch(sequence=3))
    assert bench.get("/health/ready").status_code == 200
