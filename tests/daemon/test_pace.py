"""How much goes into a request, and when the next one goes out, by what answers and timeouts show of the line."""

from math import inf, nextafter

import pytest

from beamtouch_daemon.delivery.pace import RequestPace, most_in_batch
from beamtouch_service.samples import MAX_SAMPLES

QUICKEST_S = 0.125


def pace_of(most: int = 25, stale_s: float | None = None) -> RequestPace:
    """Return the pace of four channels on a line whose quickest request took `QUICKEST_S`."""
    pace = RequestPace(4)
    pace.stale_s, pace.most = stale_s, most
    answered(pace, 1, QUICKEST_S)
    return pace


def answered(pace: RequestPace, samples: int, took_s: float, now_s: float = 0.0) -> int:
    """Let a live batch be answered; return the limit of the next request."""
    pace.answered(samples, took_s, now_s, is_backlog=False)
    return pace.most


def test_a_request_holds_250_samples_and_of_many_channels_fewer() -> None:
    assert [most_in_batch(channels) for channels in (1, 16, 17, 64)] == [250, 250, 235, 18]
    assert [most_in_batch(channels, MAX_SAMPLES) for channels in (4, 64)] == [2000, 18]
    assert most_in_batch(5, 9000) == 2000  # of 5 values and 15 of their covariance: 40 000 in a batch


def test_the_first_request_is_a_tenth_and_each_that_is_quick_doubles_the_next() -> None:
    assert [RequestPace(channels).most for channels in (4, 64)] == [25, 1]
    pace = pace_of()
    assert [answered(pace, pace.most, QUICKEST_S) for _ in range(5)] == [50, 100, 200, 250, 250]
    assert not pace.is_thin


def test_a_request_may_take_a_quarter_of_a_second_longer_than_the_quickest() -> None:
    pace = pace_of(stale_s=10.0)
    assert (answered(pace, 25, QUICKEST_S + 0.25), pace.is_thin) == (25, False)
    assert (answered(pace, 25, QUICKEST_S + 0.3125), pace.is_thin) == (20, True)
    assert answered(pace_of(), 25, QUICKEST_S + 0.1875) == 34  # a third more
    assert answered(pace_of(), 25, 100.0) == 12  # never less than half
    assert answered(pace_of(most=1), 1, 100.0) == 1


def test_where_answers_are_stale_soon_a_request_may_take_half_of_that_time() -> None:
    pace = pace_of(stale_s=0.25)
    assert (answered(pace, 25, QUICKEST_S + 0.125), pace.is_thin) == (25, False)
    assert (answered(pace, 25, QUICKEST_S + 0.15625), pace.is_thin) == (20, True)


def test_a_line_is_thin_until_a_request_of_the_usual_size_is_in_time() -> None:
    pace = pace_of()
    answered(pace, 25, QUICKEST_S + 0.3125)
    found = [(answered(pace, pace.most, QUICKEST_S), pace.is_thin) for _ in range(4)]
    assert found == [(40, True), (80, True), (160, True), (250, False)]


def test_a_request_of_less_than_half_the_limit_says_nothing_of_a_large_one() -> None:
    assert answered(pace_of(most=50), 24, QUICKEST_S + 10.0) == 50
    assert answered(pace_of(most=50), 25, QUICKEST_S + 10.0) == 12
    assert answered(pace_of(most=50), 24, QUICKEST_S) == 50


def test_a_service_that_takes_long_for_each_request_gets_as_many_samples_a_second_as_a_quick_one() -> None:
    for took_s, most in ((0.2, 250), (0.4, 500), (0.5, 625), (10.0, 2000)):
        pace = RequestPace(4)
        for _ in range(8):
            answered(pace, pace.most, took_s)
        assert (pace.most, pace.is_thin) == (most, False)


def test_what_is_slow_whatever_its_size_gets_no_smaller_requests() -> None:
    pace = pace_of()
    for samples in (20, 200):
        pace.answered(samples, 0.6 + 0.0009 * samples, 0.0, is_backlog=True)
    assert pace.most == 278  # a sample takes 0.9 ms, and so many a quarter of a second
    assert not pace.is_thin


def test_sizes_that_differ_little_do_not_show_what_a_sample_takes() -> None:
    pace = pace_of()
    pace.answered(20, 0.7, 0.0, is_backlog=True)
    pace.answered(40, 0.7, 0.0, is_backlog=True)
    assert (pace.most, pace.is_thin) == (20, True)


def test_the_quickest_request_is_that_of_two_windows_of_half_a_minute() -> None:
    pace = RequestPace(4)
    times = [(0.0, 0.25), (30.0, 0.75), (30.5, 0.75), (60.5, 0.75), (61.0, 0.75)]
    found = []
    for now_s, took_s in times:
        answered(pace, 0, took_s, now_s)
        found.append(pace.timeout_s)
    assert found == [2.0, 2.0, 2.0, 2.0, 3.0]  # four times the quickest, and no less than 2 s


def test_a_timeout_is_four_times_the_quickest_request_and_at_most_4_s() -> None:
    pace = RequestPace(4)
    assert pace.timeout_s == 2.0
    answered(pace, 0, 1.5)
    assert pace.timeout_s == 4.0


def test_after_a_timeout_the_next_request_gets_4_s() -> None:
    pace = RequestPace(4)
    pace.unanswered(1, nextafter(2.0, 0.0))
    assert pace.timeout_s == 2.0
    pace.unanswered(1, 2.0)
    assert pace.timeout_s == 4.0


@pytest.mark.parametrize("quickest_s", [None, QUICKEST_S])
def test_a_request_without_an_answer_is_halved_if_it_took_long(quickest_s: float | None) -> None:
    in_time_s = 0.25 + (quickest_s or 0.0)

    def after(samples: int, took_s: float) -> tuple[int, bool]:
        pace = pace_of() if quickest_s else RequestPace(4)
        pace.unanswered(samples, took_s)
        return pace.most, pace.is_thin

    late_s = nextafter(in_time_s, inf)
    assert after(25, in_time_s) == (25, False)
    assert after(25, late_s) == (12, True)
    assert after(12, late_s) == (25, True)  # it says nothing of a large one


def test_half_of_a_single_sample_is_one() -> None:
    pace = RequestPace(4)
    pace.halve(1)
    assert pace.most == 1


def test_a_live_batch_holds_half_of_a_request_or_on_a_thin_line_with_a_backlog_the_newest_three() -> None:
    pace = pace_of()
    assert [pace.live_limit(is_behind=behind) for behind in (False, True)] == [13, 13]
    pace.is_thin = True
    assert [pace.live_limit(is_behind=behind) for behind in (False, True)] == [13, 3]
    pace.most = 4
    assert pace.live_limit(is_behind=False) == 3


@pytest.mark.parametrize("stale_s", [None, 0.25])
def test_rests_on_a_thin_line_are_shares_of_the_age_at_which_an_answer_is_stale(stale_s: float | None) -> None:
    pace, age_s = pace_of(stale_s=stale_s), stale_s or 0.5
    assert pace.rest_s(took_s=0.02) == 3 * 0.02
    assert pace.rest_s(took_s=1.0) == 0.3 * age_s
    assert pace.beside_s == 0.6 * age_s
    assert pace.rest_of_backlog_s == 0.25 * age_s


def test_on_a_long_way_the_next_live_batch_goes_out_before_the_answer_to_the_last_one() -> None:
    def overlap_s(way_s: float) -> float:
        pace = RequestPace(4)
        answered(pace, 1, way_s)
        return pace.overlap_s

    assert RequestPace(4).overlap_s == inf  # nothing is known of the way
    assert [overlap_s(way_s) for way_s in (0.3 * 0.5, 0.2, 0.5)] == [inf, 0.3 * 0.5, 0.25]
