"""False contacts and false stretches of `unexplained`, as events; the benchmark false_alarms takes all masks."""

import numpy as np
import pytest
from scipy.special import chdtri

from beamtouch_models.accuracy.unexplained_thresholds import unexplained_thresholds, windows_of
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
    assert 0.05 < false_stretches_per_day(on, kept, draws) < 2
    assert 0.2 < false_stretches_of_contacts_per_day(on, kept, draws) < 2


def test_three_odd_means_of_four_in_a_row_allow_lower_thresholds_than_one() -> None:
    on = surface("bench")
    rest, misfit = unexplained_thresholds(on.prior, on.scene.sensors.rate_hz, window=4, seed=1)
    for size in (1, 2, 3, 4):
        # The chi-square quantile of one sample a day is 29 on one degree of freedom and 33 on two.
        assert misfit[size - 1] < chdtri(max(1, size - 2), 1 / on.samples_per_day) - 6
        assert misfit[size - 1] <= rest[size - 1]


def test_thresholds_of_a_growing_mean_are_no_lower_than_those_of_its_shortest_and_its_long_means() -> None:
    on = surface("bench")
    assert len(windows_of(on.filter)) == 2
    for window in windows_of(on.filter):
        rest, misfit = unexplained_thresholds(on.prior, on.scene.sensors.rate_hz, window, seed=1)
        assert all(np.array(on.thresholds.rest) >= rest)
        assert all(np.array(on.thresholds.misfit) >= misfit)
