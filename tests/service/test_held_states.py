"""How long a state is held over samples that are missing or cannot be decided, and what is known after a gap."""

import json
from typing import Any

import numpy as np
import pytest

from beamtouch_models.runtime import State, Suspects, Weighed
from beamtouch_models.runtime.decision.wrong_channels import LeftOut
from beamtouch_service.problems import Problem
from beamtouch_service.samples import Quality
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.estimate import CHUNK, Estimator
from beamtouch_service.surfaces.follower import Decision, Follower, Judge, Past
from beamtouch_service.surfaces.unexplained import Overdue, UnexplainedTracker
from service.bench import Row, parsed
from service.event_story import BETWEEN, ODD, RESTING, TOUCHING
from support.surfaces.small_model import model_of

MISSING: Row = [None, None, None]
HOLD_US = 500_000
"""`stale_ms` unless it is stated."""


def judged(*rows: tuple[int, Row], section: SurfaceSection | None = None) -> tuple[Judge, list[Decision]]:
    """Judge samples, each of its time [us]."""
    model = model_of()
    judge, decisions = Judge(model, "press-7", section or SurfaceSection()), []
    for number, (at_us, row) in enumerate(rows, 1):
        batch = parsed(row, sequence=number, quality=["missing"] * 3 if row is MISSING else None)
        (estimate,) = Estimator(model, "press-7").estimate(batch, batch.samples)
        decisions.append(judge.judge(estimate, at_us))
    return judge, decisions


def test_over_samples_without_a_decision_a_state_is_held_for_the_limit_of_age() -> None:
    judge, decisions = judged((0, TOUCHING), (1000, MISSING))
    assert [(one.state, one.held) for one in decisions] == [(State.CONTACT, State.CONTACT), (None, State.CONTACT)]
    assert [judge.is_over(at_us) for at_us in (HOLD_US, HOLD_US + 1, -HOLD_US, -HOLD_US - 1)] == [False, True] * 2
    # A sample that is decided holds it anew.
    judge, _ = judged((0, TOUCHING), (1000, MISSING), (400_000, TOUCHING), (400_001, MISSING))
    assert [judge.is_over(400_000 + at_us) for at_us in (HOLD_US, HOLD_US + 1)] == [False, True]


def test_over_a_pause_without_samples_a_state_is_held_for_four_times_as_long() -> None:
    judge, _ = judged((0, TOUCHING))
    assert [judge.is_over(at_us) for at_us in (4 * HOLD_US, 4 * HOLD_US + 1)] == [False, True]
    assert not judged()[0].is_over(10**12)  # nothing is held


def test_the_state_of_a_slow_surface_is_held_for_three_readings() -> None:
    """Of 5 ms each."""
    for stale_ms, hold_us in ((14.0, 15_000), (16.0, 16_000)):
        judge, _ = judged((0, TOUCHING), (1, MISSING), section=SurfaceSection(stale_ms=stale_ms))
        assert [judge.is_over(at_us) for at_us in (hold_us, hold_us + 1)] == [False, True]


@pytest.mark.parametrize(("after_us", "state"), [(4 * HOLD_US, State.CONTACT), (4 * HOLD_US + 1, State.CLEAR)])
def test_a_sample_after_too_long_a_pause_is_decided_alone(after_us: int, state: State) -> None:
    """It ends no contact, and begins none."""
    _, decisions = judged((0, TOUCHING), (after_us, BETWEEN))
    assert [one.state for one in decisions] == [State.CONTACT, state]
    assert decisions[1].is_certain is (state is State.CONTACT)


def test_after_samples_that_are_missing_nothing_is_known() -> None:
    judge, _ = judged((0, TOUCHING), (1000, MISSING))
    judge.miss()
    past = judge.past
    assert (past.is_known, past.decided_us, past.is_held) == (False, None, False)
    assert not judge.is_over(10**12)


def test_a_past_is_kept_as_json_and_read_again() -> None:
    judge, _ = judged((0, TOUCHING), (1000, MISSING))
    past = judge.past
    assert (past.is_known, past.decided_us, past.is_held) == (True, 0, True)
    kept: dict[str, Any] = json.loads(json.dumps(past._asdict()))
    assert Past.read(kept) == past
    for name in kept:
        with pytest.raises(KeyError):
            Past.read({key: value for key, value in kept.items() if key != name})


def test_the_misfit_is_the_smaller_of_that_of_rest_and_of_a_contact_with_its_own_limit() -> None:
    model = model_of()
    _, (rest, touch, odd) = judged((0, RESTING), (5000, TOUCHING), (10_000, ODD))
    for decision, (misfit, limit) in ((rest, (0.0, 30.0)), (touch, (0.0, 30.0)), (odd, (500.0, 30.0))):
        found = decision.misfit(model)
        assert (round(found[0], 3), found[1]) == (misfit, limit)
    # Of two channels, this model takes any contact.
    batch = parsed(TOUCHING, quality=["good", "good", "stuck"])
    (estimate,) = Estimator(model, "press-7").estimate(batch, batch.samples)
    decision = Judge(model, "press-7", SurfaceSection()).judge(estimate, 0)
    assert decision.misfit(model) == (0.0, 1e6)
    assert decision.notes(model) == ["unchecked"]


def followed(*rows: Row, boot_ids: tuple[str, ...] = (), numbers: tuple[int, ...] = ()) -> list[Decision]:
    """Follow samples 5 ms apart, of these boots and numbers; default: of one, in order."""
    follower, decisions = Follower(model_of(), "press-7", SurfaceSection(), lambda _: None), list[Decision]()
    for place, row in enumerate(rows):
        boot_id, number = (boot_ids or ("boot-0001",) * len(rows))[place], (numbers or range(1, len(rows) + 1))[place]
        batch = parsed(row, boot_id=boot_id, sequence=number)
        decisions += follower.follow(batch, batch.samples, [5000 * place], [])
    return decisions


def test_samples_of_one_sender_in_order_go_on_and_others_begin_anew() -> None:
    states = [one.state for one in followed(TOUCHING, BETWEEN)]
    assert states == [State.CONTACT, State.CONTACT]
    for more in ({"numbers": (1, 3)}, {"numbers": (2, 1)}, {"boot_ids": ("boot-0001", "boot-0002")}):
        assert [one.state for one in followed(TOUCHING, BETWEEN, **more)] == [State.CONTACT, State.CLEAR], more


def test_a_long_stretch_is_told_once_with_whom_its_samples_suspected_last() -> None:
    rest, *_, odd = followed(RESTING, ODD, ODD, ODD)
    since_us = odd.estimate.sample.acquired_unix_us
    stretches = UnexplainedTracker(0.5)
    stretches.add(odd._replace(suspect="s1", shift_mm=0.25), 9.0)  # of the time before it, nothing is known
    stretches.add(odd, 0.5)
    assert (stretches.is_overdue, stretches.take_overdue(), stretches.shift_mm) == (False, None, 0.25)
    stretches.add(odd, 0.001)
    assert stretches.is_overdue
    assert stretches.take_overdue() == Overdue(since_us, "s1", 0.25)
    stretches.add(odd, 1.0)
    assert stretches.take_overdue() is None
    assert (stretches.count, round(stretches.total_s, 6)) == (1, 1.501)
    stretches.add(rest, 1.0)
    assert (stretches.is_overdue, stretches.shift_mm) == (False, None)
    for _ in range(2):
        stretches.add(odd, 0.6)
    assert stretches.take_overdue() == Overdue(since_us, None, None)
    assert (stretches.count, round(stretches.total_s, 6)) == (2, 2.101)


@pytest.mark.parametrize(("samples", "examined"), [(1, 1), (40, 40), (41, 41), (42, 41), (60, 41), (61, 42), (81, 43)])
def test_of_a_stretch_the_first_forty_samples_are_examined_and_then_each_twentieth(
    monkeypatch: pytest.MonkeyPatch, samples: int, examined: int
) -> None:
    calls, leave_out = list[int](), Suspects.leave_out

    def counting(suspects: Suspects, weighed: Weighed) -> list[dict[str, LeftOut]]:
        calls.append(1)
        return leave_out(suspects, weighed)

    monkeypatch.setattr(Suspects, "leave_out", counting)
    followed(RESTING, *[ODD] * (2 + samples))  # the state follows from the third
    assert len(calls) == examined


def test_each_run_of_the_graph_is_timed_and_holds_64_samples() -> None:
    assert CHUNK == 64
    for count, runs in ((CHUNK, 1), (CHUNK + 1, 2), (0, 0)):
        times_s = list[float]()
        batch = parsed(*[TOUCHING] * max(1, count))
        estimates = list(Estimator(model_of(), "press-7", times_s.append).estimate(batch, batch.samples[:count]))
        assert (len(times_s), len(estimates)) == (runs, count)
        assert all(0.0 < took_s < 1.0 for took_s in times_s)
        assert [one.sample.sequence for one in estimates] == list(range(1, count + 1))


def test_of_samples_together_those_with_enough_channels_have_evidence() -> None:
    """Two, for this model."""
    batch = parsed(*[TOUCHING] * 4)
    for sample, stuck in zip(batch.samples, (0, 1, 2, 3), strict=True):
        sample.quality[:stuck] = [Quality.STUCK] * stuck
    each = list(Estimator(model_of(), "press-7").estimate(batch, batch.samples))
    assert [len(one.bad) for one in each] == [0, 1, 2, 3]
    assert [isinstance(one.evidence, Problem) for one in each] == [False, False, True, True]
    details = [one.evidence.detail for one in each if isinstance(one.evidence, Problem)]
    named = "s1 (stuck), s2 (stuck)"
    assert details == [
        f"Only 1 channel works; the model needs 2. Check {named}.",
        f"Only 0 channels work; the model needs 2. Check {named}, s3 (stuck).",
    ]
    assert [one.together.deflection_mm[one.row].tolist() for one in each[:2]] == [TOUCHING, [0.0, 0.25, 0.125]]


def test_noise_and_readings_make_the_covariance_of_a_sample() -> None:
    """The noise of a reading squared over their number; of two that contradict each other, the larger one counts."""
    for noise_mm, counts_mm in ((None, 0.01), ([0.012] * 3, 0.012), ([0.02] * 3, 0.02), ([0.005] * 3, 0.01)):
        batch = parsed(TOUCHING).model_copy(update={"noise_mm": noise_mm})
        sample = batch.samples[0].model_copy(update={"readings": 4})
        (one,) = Estimator(model_of(), "press-7").estimate(batch, [sample])
        assert one.together.covariance_mm2[0] == pytest.approx(np.eye(3) * counts_mm**2 / 4)
        assert one.together.noise_mm2[0] == pytest.approx([counts_mm**2 / 4] * 3)


def test_a_stated_covariance_is_taken_as_it_is_and_drifted_zeros_are_added_to_it() -> None:
    batch = parsed(*[TOUCHING] * 3).model_copy(update={"noise_mm": [0.012] * 3})
    stated = [4e-4, 1e-4, 5e-4, 0.0, 2e-4, 6e-4]
    updates: list[dict[str, object]] = [{"covariance_mm2": stated}, {"zero_mm": [0.1, 0.05]}, {}]
    samples = [one.model_copy(update={"readings": 4} | more) for one, more in zip(batch.samples, updates, strict=True)]
    first, second, third = (
        one.together.covariance_mm2[one.row] for one in Estimator(model_of(), "press-7").estimate(batch, samples)
    )
    assert first == pytest.approx(np.array([[4e-4, 1e-4, 0.0], [1e-4, 5e-4, 2e-4], [0.0, 2e-4, 6e-4]]))
    noise_mm2 = np.eye(3) * 0.012**2 / 4
    assert third == pytest.approx(noise_mm2)
    assert second == pytest.approx(noise_mm2 + 0.1**2 + np.eye(3) * 0.05**2)


@pytest.mark.parametrize(
    ("noise_mm", "contradicts"),
    [
        (None, False),
        ([0.01, 0.01, 0.0125], False),
        ([0.01, 0.01, 0.01251], True),
        ([0.008, 0.01, 0.01], False),
        ([0.00799, 0.01, 0.01], True),
    ],
)
def test_a_noise_contradicts_the_model_beyond_a_quarter(noise_mm: list[float] | None, contradicts: bool) -> None:
    """That of any channel."""
    estimator = Estimator(model_of(), "press-7")
    plain = parsed()
    for batch, said in ((plain.model_copy(update={"noise_mm": noise_mm}), contradicts), (plain, False)):
        list(estimator.estimate(batch, batch.samples))
        assert estimator.contradicts is said


def test_a_deflection_may_be_as_large_as_any_load_makes_it() -> None:
    model = model_of()
    largest_mm = model.largest_mm
    for sign in (1, -1):
        batch = parsed([sign * largest_mm, 0.25, 0.125], [sign * 1.0001 * largest_mm, 0.25, 0.125])
        taken, left_out = Estimator(model, "press-7").estimate(batch, batch.samples)
        assert (taken.bad, left_out.bad) == ({}, {"s1": "out-of-range"})
