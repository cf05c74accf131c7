"""What a look at the clocks makes of the time of a record, and what it says of them."""

import pytest

from beamtouch_service.record.writing.ageing import RecordTime, Watch

KEEP_S, NOW_S, UP_S = 864_000.0, 1.8e9, 500.0
"""Ten days; and clocks at the first look."""
HOUR_S = 3600.0
STORED = RecordTime(1000.0, NOW_S - 60)


def begun(stored: RecordTime = STORED) -> Watch:
    """Return the watch after the first look."""
    time, watch, _ = Watch(KEEP_S).look(stored, NOW_S, UP_S)
    assert time == stored
    return watch


def after(ran_s: float, jump_s: float = 0.0, stored: RecordTime = STORED) -> tuple[RecordTime, Watch, str]:
    """Look again after this time, in which the wall clock was set by so much."""
    return begun(stored).look(stored, NOW_S + ran_s + jump_s, UP_S + ran_s)


def test_the_time_of_the_record_passes_as_a_service_runs() -> None:
    time, watch, warning = after(10.0)
    assert (time, warning) == (RecordTime(1010.0, NOW_S - 50), "")
    assert (watch.looked_s, watch.steady_since_s, watch.is_trusted) == (UP_S + 10, UP_S, False)
    # What no clock was trusted for passes all the same, and a clock that lags behind the record holds it up no longer.
    assert after(10.0, stored=RecordTime(1000.0))[0] == RecordTime(1010.0, None)
    assert after(10.0, stored=RecordTime(1000.0, NOW_S + 11))[0] == RecordTime(1010.0, NOW_S + 11)
    assert after(10.0, stored=RecordTime(1000.0, NOW_S + 10))[0] == RecordTime(1000.0, NOW_S + 10)


def test_several_services_count_no_more_than_has_passed() -> None:
    assert after(10.0, stored=RecordTime(1000.0, NOW_S + 7))[0] == RecordTime(1003.0, NOW_S + 10)


def test_a_clock_is_trusted_after_an_hour_and_then_tells_how_long_no_service_ran() -> None:
    assert not after(HOUR_S - 1)[1].is_trusted
    time, watch, _ = after(HOUR_S)
    assert watch.is_trusted
    assert time == RecordTime(1000.0 + 60 + HOUR_S, NOW_S + HOUR_S)
    # That counts once.
    time, watch, _ = watch.look(RecordTime(1000.0, NOW_S), NOW_S + HOUR_S + 10, UP_S + HOUR_S + 10)
    assert (time, watch.is_trusted) == (RecordTime(1010.0, NOW_S + HOUR_S + 10), True)


def test_the_time_without_a_service_counts_for_a_tenth_of_the_age_at_most() -> None:
    days = RecordTime(1000.0, NOW_S - 3 * 86_400)
    assert after(HOUR_S, stored=days)[0] == RecordTime(1000.0 + 86_400 + HOUR_S, NOW_S + HOUR_S)


@pytest.mark.parametrize(("jump_s", "way"), [(70.5, "forward"), (-70.5, "back")])
def test_a_clock_that_jumps_was_set(jump_s: float, way: str) -> None:
    """By more than a minute and a thousandth of the time since."""
    assert after(10_000.0, jump_s * 70.0 / 70.5)[2] == ""
    _, watch, warning = after(10_000.0, jump_s)
    assert warning.startswith(f"the clock was set {way} by ")
    assert warning.endswith("; events age as before")
    assert (watch.is_trusted, watch.steady_since_s) == (False, UP_S + 10_000.0)


def said(stored: RecordTime) -> str:
    return Watch(KEEP_S).look(stored, NOW_S, UP_S)[2]


def test_a_clock_far_from_the_last_entry_is_doubted() -> None:
    assert said(RecordTime(1000.0)) == ""
    assert said(RecordTime(1000.0, NOW_S - 86_400)) == ""
    assert " after the last entry of the record" in said(RecordTime(1000.0, NOW_S - 86_401))
    assert said(RecordTime(1000.0, NOW_S + 60)) == ""
    assert " before the last entry of the record" in said(RecordTime(1000.0, NOW_S + 61))
