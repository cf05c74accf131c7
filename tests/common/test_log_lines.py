"""The log of both programs: lines about what repeats, and the two formats."""

import argparse
import json
import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime

import pytest

from beamtouch_common.log_lines import (
    MAX_REASONS,
    JsonFormatter,
    Level,
    Repeated,
    RepeatedFilter,
    TextFormatter,
    add_level_option,
    set_up,
)

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


def levels(*words: str) -> list[Level]:
    parser = argparse.ArgumentParser()
    add_level_option(parser, "beamtouch_daemon", ["sources", "delivery"])
    given: list[Level] = parser.parse_args(words).log_level
    return given


def test_levels_are_of_the_program_or_of_a_part_of_it() -> None:
    assert levels() == []
    assert levels("--log-level", "debug", "--log-level", "sources=error") == [
        Level("beamtouch_daemon", logging.DEBUG),
        Level("beamtouch_daemon.sources", logging.ERROR),
    ]
    assert levels("--log-level", "warning") == [Level("beamtouch_daemon", logging.WARNING)]


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("loud", "'loud' must end with one of debug, info, warning, error"),
        ("sources=loud", "'sources=loud' must end with one of debug, info, warning, error"),
        ("other=info", "'other=info' must begin with one of delivery, sources"),
        ("=info", "'=info' must begin with one of delivery, sources"),
    ],
)
def test_another_level_or_part_is_refused(word: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        levels("--log-level", word)
    assert said in capsys.readouterr().err


@contextmanager
def own_loggers() -> Iterator[logging.Logger]:
    """Loggers without handlers and levels; those of the tests are put back."""
    root, names = logging.getLogger(), ("", "pymodbus", "beamtouch_tests", "beamtouch_tests.log")
    before, handlers = {name: logging.getLogger(name).level for name in names}, root.handlers[:]
    root.handlers = []
    for name in names:
        logging.getLogger(name).setLevel(logging.NOTSET)
    try:
        yield root
    finally:
        root.handlers = handlers
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


@pytest.mark.parametrize(
    ("given", "root", "program", "part"),
    [
        ([], logging.INFO, logging.NOTSET, logging.NOTSET),
        ([Level("beamtouch_tests", logging.DEBUG)], logging.INFO, logging.DEBUG, logging.NOTSET),
        ([Level("beamtouch_tests", logging.ERROR)], logging.ERROR, logging.ERROR, logging.NOTSET),
        ([Level("beamtouch_tests", logging.INFO)], logging.INFO, logging.INFO, logging.NOTSET),
        ([Level("beamtouch_tests.log", logging.ERROR)], logging.INFO, logging.NOTSET, logging.ERROR),
    ],
)
def test_less_of_a_program_is_less_of_its_libraries_and_a_part_has_a_level_of_its_own(
    given: list[Level], root: int, program: int, part: int
) -> None:
    with own_loggers() as logger:
        set_up(levels=given)
        found = [logging.getLogger(name).level for name in ("", "beamtouch_tests", "beamtouch_tests.log", "pymodbus")]
        (handler,) = logger.handlers
    assert found == [root, program, part, logging.CRITICAL]
    assert isinstance(handler.formatter, TextFormatter)


def test_a_log_may_be_json() -> None:
    with own_loggers() as logger:
        set_up(as_json=True)
        (handler,) = logger.handlers
    assert isinstance(handler.formatter, JsonFormatter)


def test_the_shortest_time_between_lines_can_be_chosen(clock: Clock, caplog: pytest.LogCaptureFixture) -> None:
    repeated = Repeated(LOG, "press-7", every_s=5.0, clock=clock)
    for clock.now_s in (0.0, 4.9, 5.0, 9.9):
        repeated.failed("no answer from port 3", "no answer")
    assert caplog.messages == [
        "press-7: no answer from port 3",
        "press-7: no answer from port 3 (2 times since the last such line)",
    ]
    assert repeated.line_if_due("no answer from port 4", "no answer") == ""
    assert repeated.line_if_due("no answer from port 4") == "no answer from port 4"
