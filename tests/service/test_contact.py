"""What the model's answer comes to. Numbers by hand."""

import math
from dataclasses import asdict

import pytest

from beamtouch_service.surfaces.contact import State, UnusableEstimateError, decide, rfc3339

ESTIMATE = {
    "contact_log_odds": 3.0,
    "position_mm": 123.45678,
    "position_low_mm": 121.9,
    "position_high_mm": 125.0,
    "force_n": 9.8,
    "force_low_n": 9.5,
    "force_high_n": 10.1,
}


def test_odds_above_the_threshold_are_a_contact_with_all_figures() -> None:
    decision = decide(ESTIMATE, threshold=2.0, length_mm=400)

    assert decision.state is State.CONTACT
    assert asdict(decision.figures) == {
        "position_mm": 123.4568,
        "position_low_mm": 121.9,
        "position_high_mm": 125.0,
        "force_n": 9.8,
        "force_low_n": 9.5,
        "force_high_n": 10.1,
    }


@pytest.mark.parametrize("threshold", [3.0, 4.0], ids=["exactly there", "below"])
def test_odds_up_to_the_threshold_are_clear_and_have_no_figures(threshold: float) -> None:
    decision = decide(ESTIMATE, threshold, length_mm=400)

    assert decision.state is State.CLEAR
    assert set(asdict(decision.figures).values()) == {None}


def test_a_model_without_force_and_intervals_leaves_them_null() -> None:
    decision = decide({"contact_log_odds": 1.0, "position_mm": 50.0}, threshold=0, length_mm=400)

    assert decision.figures.position_mm == 50.0
    assert decision.figures.position_low_mm is None
    assert decision.figures.force_n is None


@pytest.mark.parametrize("name", list(ESTIMATE))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_never_an_answer(name: str, value: float) -> None:
    with pytest.raises(UnusableEstimateError, match=f"{name} is not a finite number"):
        decide(ESTIMATE | {name: value}, threshold=0, length_mm=400)


def test_a_position_beyond_the_end_is_an_answer_only_while_its_interval_meets_the_beam() -> None:
    estimate = {"contact_log_odds": 1.0, "position_mm": 400.5, "position_low_mm": 398.0, "position_high_mm": 403.0}
    assert decide(estimate, threshold=0, length_mm=400).figures.position_mm == 400.5

    with pytest.raises(UnusableEstimateError, match="off a beam of 400 mm"):
        decide(estimate | {"position_low_mm": 400.1}, threshold=0, length_mm=400)
    with pytest.raises(UnusableEstimateError, match=r"position_mm is -0\.5"):
        decide({"contact_log_odds": 1.0, "position_mm": -0.5}, threshold=0, length_mm=400)


def test_times_are_rfc_3339_with_milliseconds() -> None:
    assert rfc3339(0) == "1970-01-01T00:00:00.000Z"
    assert rfc3339(1_795_218_046_123_999) == "2026-11-20T23:40:46.123Z"
    assert rfc3339(2**53 - 1) == "2255-06-05T23:47:34.740Z"
