"""One surface without a web around it: freshness, order, working channels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beamtouch_models import modelfile
from beamtouch_service.problems import Kind, ProblemError
from beamtouch_service.surfaces.state import summary_of
from beamtouch_service.surfaces.surface import Surface

if TYPE_CHECKING:
    from collections.abc import Callable

    from beamtouch_service.samples import Batch
    from service.conftest import BuildModel

    ParseBatch = Callable[..., Batch]


@pytest.fixture
def surface(build_model: BuildModel) -> Surface:
    return Surface("press-7", modelfile.load(build_model()))


def problem(surface: Surface, now_s: float) -> Kind:
    with pytest.raises(ProblemError) as caught:
        surface.contact(now_s)
    return caught.value.problem.kind


def test_age_counts_from_the_acquisition_and_not_from_the_arrival(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(age_ms=100), arrival_s=10.0)

    assert surface.contact(10.0).age_ms == 100.0
    assert surface.contact(10.25).age_ms == 350.0


def test_the_limit_of_age_is_sharp(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(), arrival_s=8.0)

    assert surface.contact(8.5).age_ms == 500.0
    assert problem(surface, 8.5 + 1e-6) is Kind.STALE


def test_a_model_says_nothing_of_a_sample_from_before_it(build_model: BuildModel, parse_batch: ParseBatch) -> None:
    surface = Surface("press-7")
    surface.receive(parse_batch(), arrival_s=8.0)
    assert problem(surface, 8.1) is Kind.NO_MODEL

    surface.adopt(modelfile.load(build_model()))
    assert problem(surface, 8.1) is Kind.NO_SAMPLES
    surface.receive(parse_batch(sequence=2), arrival_s=8.2)
    assert surface.contact(8.2).sequence == 2


def test_a_batch_that_is_late_already_when_it_arrives_is_stale(surface: Surface, parse_batch: ParseBatch) -> None:
    receipt = surface.receive(parse_batch(age_ms=1e12), arrival_s=10.0)

    assert receipt.accepted == 1
    assert problem(surface, 10.0) is Kind.STALE


def test_an_older_sample_of_another_sender_changes_nothing(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch([0.5, 0.25, 0.125]), arrival_s=10.0)
    surface.receive(parse_batch([0.0, 0.0, 0.0], boot_id="boot-0000", sequence=900, age_ms=300), arrival_s=10.1)

    contact = surface.contact(10.1)
    assert (contact.sequence, contact.state.value, contact.age_ms) == (1, "contact", 100.0)


def test_a_newer_sample_of_the_same_sender_is_the_present_however_old_it_is_said_to_be(
    surface: Surface, parse_batch: ParseBatch
) -> None:
    surface.receive(parse_batch([0.5, 0.25, 0.125], sequence=10), arrival_s=10.0)
    surface.receive(parse_batch([0.0, 0.0, 0.0], sequence=11, age_ms=50), arrival_s=10.0)

    contact = surface.contact(10.0)
    assert (contact.sequence, contact.state.value, contact.age_ms) == (11, "clear", 50.0)


def test_a_stray_batch_holds_the_surface_no_longer_than_it_is_fresh(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(sequence=12), arrival_s=10.0)
    surface.receive(parse_batch([0.0, 0.0, 0.0], boot_id="stray-by-hand", sequence=1), arrival_s=10.1)
    surface.receive(parse_batch(sequence=13), arrival_s=10.6)
    assert surface.contact(10.6).sequence == 1

    surface.receive(parse_batch(sequence=14), arrival_s=10.61)
    contact = surface.contact(10.61)
    assert (contact.sequence, contact.state.value, contact.age_ms) == (14, "contact", 0.0)
    assert surface.sender_changes == 2


def test_a_repeated_batch_does_not_make_the_contact_younger(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch(), arrival_s=10.0)
    receipt = surface.receive(parse_batch(), arrival_s=10.4)

    assert (receipt.accepted, receipt.repeated) == (0, 1)
    assert surface.contact(10.4).age_ms == 400.0


def test_channels_are_matched_by_name(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch([9.0, 0.125, 0.5, 0.25], channels=["spare", "s3", "s1", "s2"]), arrival_s=10.0)

    assert surface.contact(10.0).position_mm == pytest.approx(100 + 0.25 * 100 + 0.125 * 200)


def test_a_channel_that_is_not_good_is_left_out_and_named(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch([0.5, 0.25, 3.0], quality=["good", "good", "stuck"]), arrival_s=10.0)

    contact = surface.contact(10.0)
    assert contact.position_mm == pytest.approx(125.0)
    assert (contact.quality.value, contact.degraded_channels) == ("degraded", ["s3"])


def test_a_deflection_that_float32_cannot_hold_is_no_deflection(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch([0.5, 0.25, 1e300]), arrival_s=10.0)

    assert surface.contact(10.0).degraded_channels == ["s3"]


def test_too_few_working_channels_give_no_contact(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch([0.5, None, 3.0], quality=["good", "missing", "saturated"]), arrival_s=10.0)

    with pytest.raises(ProblemError) as caught:
        surface.contact(10.0)
    assert caught.value.problem.kind is Kind.TOO_FEW_CHANNELS
    assert caught.value.problem.members == {"bad_channels": {"s2": "missing", "s3": "saturated"}}
    assert surface.unready(10.0) == caught.value.problem


def test_the_next_good_sample_ends_the_trouble(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch([None, None, None], quality=["missing"] * 3), arrival_s=10.0)
    surface.receive(parse_batch(sequence=2), arrival_s=10.005)

    assert surface.contact(10.005).quality.value == "good"


def test_an_answer_that_is_not_a_number_is_not_served(surface: Surface, parse_batch: ParseBatch) -> None:
    surface.receive(parse_batch([1.0, 0.5, 0.5]), arrival_s=10.0)

    assert problem(surface, 10.0) is Kind.UNUSABLE_ESTIMATE


def test_a_batch_without_a_channel_of_the_model_is_refused_whole(surface: Surface, parse_batch: ParseBatch) -> None:
    with pytest.raises(ProblemError) as caught:
        surface.receive(parse_batch([0.5, 0.25], channels=["s2", "other"]), arrival_s=10.0)

    assert caught.value.problem.members == {"missing_channels": ["s1", "s3"]}
    assert summary_of(surface, 10.0).samples.accepted == 0
    assert problem(surface, 10.0) is Kind.NO_SAMPLES


def test_without_a_model_samples_are_taken_and_no_contact_is_given(parse_batch: ParseBatch) -> None:
    surface = Surface("press-7")
    receipt = surface.receive(parse_batch([0.5], channels=["any"]), arrival_s=10.0)

    assert receipt.accepted == 1
    assert problem(surface, 10.0) is Kind.NO_MODEL


def test_a_model_without_force_gives_null_for_it(build_model: BuildModel, parse_batch: ParseBatch) -> None:
    model = modelfile.load(build_model(outputs=("position_mm", "contact_log_odds")))
    surface = Surface("press-7", model)
    surface.receive(parse_batch(), arrival_s=10.0)

    contact = surface.contact(10.0)
    assert contact.position_mm == pytest.approx(150.0)
    assert (contact.position_low_mm, contact.force_n, contact.force_high_n) == (None, None, None)


def test_the_summary_counts(surface: Surface, parse_batch: ParseBatch) -> None:
    rows = [[0.5, 0.25, 0.125]] * 3
    surface.receive(parse_batch(*rows, sequence=1), arrival_s=10.0)
    surface.receive(parse_batch(*rows, sequence=3), arrival_s=10.1)
    surface.receive(parse_batch(*rows, sequence=8), arrival_s=10.2)

    summary = summary_of(surface, 10.3)
    assert summary.samples.model_dump() == {"accepted": 8, "repeated": 1, "lost": 2}
    assert (summary.channels, summary.age_ms) == (["s1", "s2", "s3"], 100.0)
