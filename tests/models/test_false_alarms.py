"""False contacts and false stretches of `unexplained`, as events; the benchmark false_alarms takes all masks."""

import numpy as np
import pytest

from beamtouch_models.accuracy.thresholds import misfit_threshold, unexplained_thresholds
from false_alarms import (
    false_contacts_per_day,
    false_stretches_of_contacts_per_day,
    false_stretches_per_day,
    surface,
)

pytestmark = pytest.mark.long


@pytest.mark.parametrize(
    ("name", "kept"), [("bench", (0, 1, 2, 3)), pytest.param("short-deep", (1,), marks=pytest.mark.soak)]
)
def test_false_contacts_come_once_a_month_wherever_zeros_lie(name: str, kept: tuple[int, ...]) -> None:
    on = surface(name)
    assert on.thresholds.false_contacts_per_day == pytest.approx(1 / 30)
    assert 0.5 < 30 * false_contacts_per_day(on, kept, 512) < 2


@pytest.mark.parametrize(
    ("name", "kept", "draws"),
    [
        ("bench", (0, 1, 2, 3), 1024),
        pytest.param("bench", (0, 1, 2, 3), 4096, marks=pytest.mark.soak),
        pytest.param("cantilever", (0, 1, 2), 4096, marks=pytest.mark.soak),
    ],
)
def test_false_stretches_come_at_most_once_a_day_at_rest_and_during_contacts(
    name: str, kept: tuple[int, ...], draws: int
) -> None:
    on = surface(name)
    assert 0.01 < false_stretches_per_day(on, kept, draws) < 1
    assert 0.03 < false_stretches_of_contacts_per_day(on, kept, draws) < 1


def test_thresholds_of_noise_alone_follow_the_chi_square_distribution() -> None:
    # Once in 2e7 samples, the squares of 1, 2 and 6 directions exceed 29.7, 33.6 and 44.9 (tables).
    for channels, square in ((3, 29.7), (4, 33.6), (8, 44.9)):
        rate_hz = 0.5 / 86_400 * 2e7
        # Means of very many readings are all alike.
        assert misfit_threshold(1.0, channels, rate_hz, readings=63) == pytest.approx(square, rel=0.03)
        # To raise three means of two readings takes twice the squares that raise one.
        assert 0.4 * square < misfit_threshold(1.0, channels, rate_hz, readings=2) < 0.65 * square


def test_thresholds_rise_with_readings_that_successive_means_share_and_rest_is_no_lower_than_misfit() -> None:
    prior = surface("bench").prior
    short, long = (unexplained_thresholds(prior, 100.0, readings) for readings in (4, 24))
    for few, many in zip(short, long, strict=True):
        assert np.all(np.array(few) < many)
    for rest, misfit in (short, long):
        assert np.all(np.array(rest) >= misfit)
