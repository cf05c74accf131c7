"""The log of both programs: lines about what repeats, and the two formats."""

import json
import logging
import time
from datetime import datetime

import pytest

from beamtouch_common.log_lines import MAX_REASONS, JsonFormatter, Repeated, RepeatedFilter, TextFormatter

LOG = logging.getLogger("beamtouch_tests.log")


class Clock:
    """A clock that stands still until a test sets it."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock(caplog: pytest.LogCaptureFixture) -> Clock:
    caplog.set_level("INFO")
    return Clock()


def test_a_failure_is_logged_at_once_then_each_minute_with_its_count(
    clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    repeated = Repeated(LOG, "press-7", clock=clock)
    for clock.now_s in (0.0, 1.0, 59.9, 60.0, 61.0):
        repeated.failed("no answer")
    repeated.failed("port is gone")

    assert caplog.messages == [
        "press-7: no answer",
        "press-7: no answer (3 times since the last such line)",
        "press-7: port is gone",
    ]


def test_a_recovery_is_logged_if_its_failure_was(clock: Clock, caplog: pytest.LogCaptureFixture) -> None:
    repeated = Repeated(LOG, "press-7", clock=clock)
    repeated.over()  # nothing failed
    repeated.failed("no answer")
    clock.now_s = 2.0
    repeated.over()
    clock.now_s = 10.0
    repeated.failed("no answer")  # within the minute: neither this nor the recovery
    repeated.over()

    assert caplog.messages == ["press-7: no answer", "press-7: works again after 2.0 s"]


def test_an_outage_counts_from_its_first_failure_also_if_that_was_not_logged(
    clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    repeated = Repeated(LOG, clock=clock)
    repeated.failed("no answer")
    repeated.over()
    for clock.now_s in (5.0, 30.0, 60.0, 62.0):
        repeated.failed("no answer")
    clock.now_s = 65.0
    repeated.over()

    assert caplog.messages[1:] == [
        "works again after 0.0 s",
        "no answer (3 times since the last such line)",
        "works again after 60.0 s",
    ]


def test_things_are_counted_up_to_the_next_line(clock: Clock, caplog: pytest.LogCaptureFixture) -> None:
    repeated = Repeated(LOG, clock=clock)
    for clock.now_s, number in ((0.0, 0), (1.0, 5), (2.0, 7), (61.0, 3)):
        repeated.count(number, "samples dropped")

    assert caplog.messages == ["5 samples dropped", "10 samples dropped"]


def test_made_up_reasons_do_not_fill_the_memory(clock: Clock) -> None:
    repeated = Repeated(LOG, clock=clock)
    assert all(repeated.due(f"reason {number}") == 1 for number in range(MAX_REASONS))
    assert repeated.due("reason 0") == 0

    assert repeated.due("one more") == 1
    assert [repeated.due(reason) for reason in ("reason 1", "reason 0")] == [0, 1]  # only the oldest is forgotten


def test_a_logger_repeats_each_message_once_a_minute(clock: Clock) -> None:
    limit = RepeatedFilter(clock)
    record = logging.makeLogRecord({"msg": "Invalid HTTP request received."})
    assert [limit.filter(record) for clock.now_s in (0.0, 1.0, 59.9, 60.0)] == [True, False, False, True]

    error = logging.makeLogRecord({"msg": "failed", "exc_info": (ValueError, ValueError(), None)})
    assert [limit.filter(error) for _ in range(2)] == [True, True]


def test_an_event_in_json_is_one_line_with_its_traceback() -> None:
    try:
        1 / 0  # noqa: B018 - it fails
    except ZeroDivisionError as error:
        failed = logging.makeLogRecord(
            {"name": "beamtouch_daemon.x", "levelname": "ERROR", "msg": "%d samples", "args": (3,)}
        )
        failed.exc_info = (type(error), error, error.__traceback__)
    line = JsonFormatter().format(failed)
    assert "\n" not in line
    event = json.loads(line)
    assert datetime.fromisoformat(event.pop("time")).utcoffset() is not None
    assert event.pop("traceback").endswith("ZeroDivisionError: division by zero")
    assert event == {"level": "error", "source": "daemon.x", "message": "3 samples"}


@pytest.mark.parametrize(
    ("zone", "begins"),
    [("UTC0", "2026-11-20 23:40:46.123+00:00 INFO "), ("HERE-5:45", "2026-11-21 05:25:46.123+05:45 INFO ")],
)
def test_a_line_of_text_has_its_zone(monkeypatch: pytest.MonkeyPatch, zone: str, begins: str) -> None:
    record = logging.LogRecord("beamtouch", logging.INFO, "", 0, "a message", None, None)
    record.created = 1_795_218_046.1234
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    try:
        assert TextFormatter().format(record) == f"{begins}a message"
    finally:
        monkeypatch.undo()
        time.tzset()
