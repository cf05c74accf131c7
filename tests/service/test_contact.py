"""What the model's answer comes to. Numbers by hand."""

import math

import numpy as np
import pytest

from beamtouch_models.modelfile import Evidence
from beamtouch_service.surfaces.contact import UnusableEstimateError, figures_of, require_usable, rfc3339

ESTIMATE = {
    "position_mm": 123.45678,
    "position_low_mm": 121.9,
    "position_high_mm": 125.0,
    "force_n": 9.8,
    "force_low_n": 9.5,
    "force_high_n": 10.1,
}


def test_a_contact_has_all_figures() -> None:
    assert figures_of(ESTIMATE, length_mm=400)._asdict() == {
        "position_mm": 123.4568,
        "position_low_mm": 121.9,
        "position_high_mm": 125.0,
        "force_n": 9.8,
        "force_low_n": 9.5,
        "force_high_n": 10.1,
    }


def test_a_model_without_force_and_intervals_leaves_them_null() -> None:
    figures = figures_of({"contact_log_odds": 1.0, "position_mm": 50.0}, length_mm=400)

    assert figures.position_mm == 50.0
    assert figures.position_low_mm is None
    assert figures.force_n is None


@pytest.mark.parametrize("name", list(ESTIMATE))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_never_an_answer(name: str, value: float) -> None:
    with pytest.raises(UnusableEstimateError, match=f"{name} is not a finite number"):
        figures_of(ESTIMATE | {name: value}, length_mm=400)


@pytest.mark.parametrize("name", ["contact_log_odds", "misfit"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_nothing_is_decided_on_what_is_not_finite(name: str, value: float) -> None:
    answer = ESTIMATE | {"contact_log_odds": 3.0, "misfit": 1.0, name: value}
    with pytest.raises(UnusableEstimateError, match=f"{name} is not a finite number"):
        require_usable(Evidence(np.zeros(3), np.eye(3), answer, 3, 0.0, False, 0.0, np.eye(3)))


def test_a_position_beyond_the_end_is_an_answer_only_while_its_interval_meets_the_beam() -> None:
    estimate = {"position_mm": 400.5, "position_low_mm": 398.0, "position_high_mm": 403.0}
    assert figures_of(estimate, length_mm=400).position_mm == 400.5

    with pytest.raises(UnusableEstimateError, match="off a beam of 400 mm"):
        figures_of(estimate | {"position_low_mm": 400.1}, length_mm=400)
    with pytest.raises(UnusableEstimateError, match=r"position_mm is -0\.5"):
        figures_of({"position_mm": -0.5}, length_mm=400)


def test_times_are_rfc_3339_with_milliseconds() -> None:
    assert rfc3339(0) == "1970-01-01T00:00:00.000Z"
    assert rfc3339(1_795_218_046_123_999) == "2026-11-20T23:40:46.123Z"
    assert rfc3339(2**53 - 1) == "2255-06-05T23:47:34.740Z"
