"""What one contact says of gains and zeros: the information left when place and force are unknown, by dense sums."""

import math

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime import BestSample, Health, Metadata
from beamtouch_models.runtime.departures import Calibration, Departures
from beamtouch_models.runtime.metadata_parts import Floor, Influence, Thresholds
from support.surfaces.small_model import model_of

SLOPES, EVEN = np.array([2.0, -1.2, 0.7, 1.6]) / 1e4, np.array([0.01, 0.07, 0.03, 0.02])
"""Of four sensors that show a force by levers, in mm/N."""
GAIN, ZERO_MM = np.array([0.02, 0.03, 0.025, 0.015]), np.array([0.003, 0.002, 0.004, 0.001])
AT_MM, FORCE_N = 230.0, 12.0
DEVIATION_MM, REST_MM = np.array([0.004, 0.003, 0.005, 0.002]), np.array([0.001, -0.002, 0.003, 0.0005])
REST_DEVIATION_MM = np.array([0.0015, 0.002, 0.001, 0.0025])
OFFSET_MM, CURVE = np.array([0.02, -0.01, 0.03, 0.015]), 0.05


def metadata_with(limit: float = 1e5, *, calibrated: bool = False) -> Metadata:
    ticks_mm = np.linspace(1.0, 399.0, 9)
    departures = Departures.none(4).model_copy(update={"offset_mm": OFFSET_MM.tolist(), "curve_per_mm": CURVE})
    parts = {
        "influence": Influence(mm_per_n=(ticks_mm[:, None] * SLOPES + EVEN).tolist()),
        "floor": Floor(gain=GAIN.tolist(), zero_mm=ZERO_MM.tolist()),
        "thresholds": Thresholds(
            touch=[10.0] * 4, rest=[30.0] * 4, misfit=[1e6, 1e6, limit, 1e6], false_contacts_per_day=1.0
        ),
        "calibration": Calibration(departures=departures, fitted=[], loads=9, residual_mm=0.0) if calibrated else None,
    }
    return model_of(channels=4).metadata.model_copy(update=parts)


def shape_at(at_mm: float) -> Floats:
    """Return what a newton shows there."""
    return EVEN + at_mm * SLOPES


def contact(linear_mm: Floats, *, rested: bool = True, is_contact: bool = True, calibrated: bool = False) -> BestSample:
    """Return the best sample of a contact that bends the sensors so, from their rest."""
    bent = linear_mm if not calibrated else (np.sqrt(1 + 4 * CURVE * linear_mm) - 1) / (2 * CURVE)
    rest_mm = REST_MM + (OFFSET_MM if calibrated else 0.0)
    seen_mm = bent + (rest_mm if rested else OFFSET_MM * calibrated)
    return BestSample(
        7_000_000,
        seen_mm.tolist(),
        DEVIATION_MM.tolist(),
        rest_mm.tolist() if rested else None,
        REST_DEVIATION_MM.tolist() if rested else None,
        is_contact,
    )


def spread_mm2(linear_mm: Floats, *, rested: bool) -> Floats:
    """Return the variance of a contact: of noise and zero, and of a third of the floor, which scatters."""
    floor = (GAIN * linear_mm) ** 2 + ZERO_MM**2
    return np.asarray(DEVIATION_MM**2 + (REST_DEVIATION_MM if rested else ZERO_MM) ** 2 + floor / 9)


def kept_of(history: Health) -> tuple[Floats, Floats, Floats, Floats]:
    """Return information and score of the gains, and weight and sum of the rests."""
    ((first_us, contacts, *sums),) = history.to_json()["blocks"]
    assert (first_us, contacts) == (7_000_000, 1)
    information, score, weight, total = (np.array(values) for values in sums)
    return information, score, weight, total


@pytest.mark.parametrize("calibrated", [False, True])
@pytest.mark.parametrize("rested", [True, False])
def test_a_contact_says_of_gains_what_neither_its_place_nor_its_force_explains(rested: bool, calibrated: bool) -> None:
    errors = np.array([0.004, -0.006, 0.003, 0.002])
    clean_mm = FORCE_N * shape_at(AT_MM)
    health = Health(metadata_with(calibrated=calibrated))
    health.add([contact(clean_mm * (1 + errors), rested=rested, calibrated=calibrated)])
    information, score, weight, total = kept_of(health)
    # The errors of place and force may be of any size.
    variance = spread_mm2(clean_mm, rested=rested)
    slopes = np.ones(4) if not calibrated else 1 / np.sqrt(1 + 4 * CURVE * clean_mm)
    free = np.stack([FORCE_N * SLOPES, shape_at(AT_MM)], axis=1) * slopes[:, None]
    covariance = np.diag(variance) + 1e4 * free @ free.T
    moved = np.diag(clean_mm * slopes)
    expected = moved @ np.linalg.inv(covariance) @ moved
    assert information == pytest.approx(expected, rel=0.03, abs=0.01 * np.abs(expected).max())
    assert score == pytest.approx(information @ errors, rel=0.02, abs=0.01 * np.abs(score).max())
    if rested:
        assert weight == pytest.approx(1 / (REST_DEVIATION_MM**2 + ZERO_MM**2 / 9))
        assert total == pytest.approx(weight * REST_MM)
    else:
        assert not weight.any()
        assert not total.any()


def misfit_of(left_mm: Floats, clean_mm: Floats, *, without: int | None = None) -> float:
    """Return the misfit of residuals, with the gain errors that the floor allows for; one may be of any size."""
    free = np.stack([FORCE_N * SLOPES, shape_at(AT_MM)], axis=1)
    covariance = np.diag(spread_mm2(clean_mm, rested=True) + (GAIN * clean_mm) ** 2) + 1e4 * free @ free.T
    if without is not None:
        covariance[without, without] += 1e4
    return float(left_mm @ np.linalg.solve(covariance, left_mm))


@pytest.mark.parametrize(("size", "is_bounded"), [(0.8, False), (1.4, True), (3.0, True)])
def test_no_contact_counts_for_more_than_a_misfit_of_twenty(size: float, is_bounded: bool) -> None:
    clean_mm = FORCE_N * shape_at(AT_MM)
    left_mm = np.array([0.0, 0.0, 0.09 * size, 0.0])
    misfit = misfit_of(left_mm, clean_mm)
    assert (misfit > 20) is is_bounded
    sure, doubtful = Health(metadata_with()), Health(metadata_with())
    sure.add([contact(clean_mm)])
    doubtful.add([contact(clean_mm + left_mm)])
    weight = np.median(kept_of(doubtful)[0] / kept_of(sure)[0])
    # The floor and the variance follow from what was measured, not from what is true.
    assert weight == pytest.approx(min(1.0, 20 / misfit), rel=0.25)


def test_a_sample_that_no_contact_explains_counts_if_a_change_of_one_channel_does() -> None:
    clean_mm = FORCE_N * shape_at(AT_MM)
    for left_mm in (np.array([-0.04, 0.0, 0.0, 0.03]), np.array([-0.05, 0.0, 0.0, 0.035])):
        least = min(misfit_of(left_mm, clean_mm, without=channel) for channel in range(4))
        assert 1 < least < 0.8 * misfit_of(left_mm, clean_mm)
        for factor, is_used in ((0.85, False), (1.1, True)):
            health = Health(metadata_with(factor * least))
            health.add([contact(clean_mm + left_mm, is_contact=False)])
            assert health.contacts == int(is_used)
            health = Health(metadata_with(factor * least))
            health.add([contact(clean_mm + left_mm, is_contact=True)])
            assert health.contacts == 1
    assert Health(metadata_with()).channels() == []


@pytest.mark.parametrize(
    ("kept", "said"),
    [
        ({}, "what was kept cannot be read"),
        ({"blocks": [[0, 1]]}, "the history is that of another layout"),
        ({"blocks": [[0, 1, [[1.0] * 3] * 3, [1.0] * 3, [1.0] * 3, [1.0] * 3]]}, "that of another layout"),
        ({"blocks": [7]}, "what was kept cannot be read"),
    ],
)
def test_a_history_that_was_kept_otherwise_is_refused(kept: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Health(metadata_with(), kept)


def test_a_history_goes_on_from_what_was_kept() -> None:
    health = Health(metadata_with())
    health.add([contact(FORCE_N * shape_at(at_mm)) for at_mm in (50.0, 150.0, 310.0)])
    again = Health(metadata_with(), health.to_json())
    assert again.contacts == 3
    assert again.channels() == health.channels()
    assert [one.contacts for one in again.channels()] == [3] * 4
    assert all(math.isfinite(one.gain.low) for one in again.channels())
