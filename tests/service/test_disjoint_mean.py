"""The mean position of an event counts each reading once."""

import pytest

from beamtouch_service.events.disjoint_mean import DisjointMean


def mean_of(*samples: tuple[int, int, float], first_sequence: int = 1) -> float:
    mean = DisjointMean(first_sequence)
    for sequence, readings, position_mm in samples:
        mean.add(sequence, readings, position_mm)
    return mean.mean_mm


def test_a_growing_mean_counts_with_its_last_sample() -> None:
    assert mean_of(*((number, number, float(number)) for number in range(1, 6))) == 5.0


def test_stretches_count_with_their_readings() -> None:
    first = [(number, number, 100.0) for number in range(1, 31)]
    second = [(30 + number, number, 200.0) for number in range(1, 11)]
    assert mean_of(*first, *second) == pytest.approx((30 * 100 + 10 * 200) / 40)


def test_windows_that_slide_count_once_per_window() -> None:
    # Means of 4 at readings 4, 8 and 12 share none.
    assert mean_of(*((number, 4, float(number)) for number in range(4, 14))) == pytest.approx((4 + 8 + 12) / 3)


def test_single_readings_are_the_plain_mean() -> None:
    assert mean_of((1, 1, 3.0), (2, 1, 5.0), (9, 1, 1.0)) == 3.0


@pytest.mark.parametrize("cut", [1, 5, 29, 30, 31, 45, 59])
def test_parts_of_an_event_together_have_its_mean(cut: int) -> None:
    samples = [(number, number, 100.0) for number in range(1, 31)]
    samples += [(30 + number, number, 300.0) for number in range(1, 31)]
    before = cut * mean_of(*samples[:cut])
    after = (60 - cut) * mean_of(*samples[cut:], first_sequence=cut + 1)
    assert (before + after) / 60 == pytest.approx(mean_of(*samples)) == 200.0


def test_without_samples_it_is_0() -> None:
    assert mean_of() == 0.0
