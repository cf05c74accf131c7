"""The mean of samples of which some share readings: each reading counts once."""

from beamtouch_service.record.events.best import Best, DisjointMean, Mean

READING_US = 1000.0


def mean_of(*samples: tuple[int, int, float], max_samples: float = float("inf")) -> DisjointMean:
    """Return the mean of samples of a time [us], a number of readings and a value [mm], all of variance 1."""
    mean = DisjointMean()
    for at_us, readings, mm in samples:
        mean.add(at_us, readings, READING_US, [mm], [1.0], max_samples)
    return mean


def test_samples_without_common_readings_count_by_their_readings() -> None:
    assert mean_of().of_all() is None
    assert mean_of((10_000, 4, 1.0)).of_all() == Mean([1.0], [1.0], 4)
    # Readings of 3.5 ms end at 10 ms, and the next ones begin there.
    mean = mean_of((10_000, 4, 1.0), (21_500, 12, 5.0))
    assert (mean.before, mean.newest) == (Mean([1.0], [1.0], 4), Mean([5.0], [1.0], 12))
    assert mean.of_all() == Mean([4.0], [0.625], 16)
    assert (mean.begin_us, mean.end_us) == (10_000.0, 21_500)


def test_of_samples_with_common_readings_the_one_with_most_counts_and_of_equal_ones_the_first() -> None:
    first = (10_000, 4, 1.0)
    assert mean_of(first, (10_000, 8, 2.0)).of_all() == Mean([2.0], [1.0], 8)
    assert mean_of(first, (10_000, 4, 2.0)).of_all() == Mean([1.0], [1.0], 4)
    # It holds all readings of the first, from its begin on.
    assert mean_of(first, (11_000, 5, 2.0)).of_all() == Mean([2.0], [1.0], 5)
    # One that begins later lacks some, and one with fewer readings knows less.
    assert mean_of(first, (12_000, 5, 2.0)).of_all() == Mean([1.0], [1.0], 4)
    assert mean_of(first, (9_000, 3, 2.0)).of_all() == Mean([1.0], [1.0], 4)


def test_the_mean_before_a_sample_counts_for_so_many_samples_like_it_at_most() -> None:
    samples = [(10_000, 4, 1.0), (20_000, 4, 1.0), (30_000, 4, 1.0), (40_000, 2, 6.0)]
    assert mean_of(*samples).of_all(max_samples=4) == Mean([2.0], [0.6**0 * (0.8**2 * (1 / 3) + 0.2**2)], 10)
    bounded = mean_of(*samples, (50_000, 2, 6.0), max_samples=1).before
    assert bounded is not None
    assert (bounded.mm, bounded.weight) == ([3.5], 4)


def test_a_mean_is_read_as_it_was_kept() -> None:
    mean = mean_of((10_000, 4, 1.0), (20_000, 4, 2.0))
    assert DisjointMean.read(mean.to_json()) == mean
    assert DisjointMean.read(mean_of((10_000, 4, 1.0)).to_json()) == mean_of((10_000, 4, 1.0))
    assert DisjointMean.read(None) == DisjointMean()


def test_a_best_sample_that_cannot_be_read_is_none() -> None:
    assert Best.read(None) is None
    assert Best.read({"at_us": 1}) is None
