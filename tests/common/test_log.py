"""The log of both programs: lines about what repeats, and the two formats."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from datetime import datetime

import pytest

from beamtouch_common.log import MAX_REASONS, Repeated, RepeatedFilter

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


LOGGING = """
import logging
from beamtouch_common import log
log.set_up(as_json={as_json})
logging.getLogger("beamtouch_daemon.x").warning("%d samples", 3)
logging.getLogger("beamtouch_daemon.x").debug("hidden")
try:
    1 / 0
except ZeroDivisionError:
    logging.getLogger("x").exception("failed")
"""


def _lines(*, as_json: bool) -> list[str]:
    program = [sys.executable, "-c", LOGGING.format(as_json=as_json)]
    outcome = subprocess.run(program, capture_output=True, text=True, check=True)
    assert outcome.stdout == ""
    return outcome.stderr.splitlines()


def test_the_log_is_lines_of_json() -> None:
    event, failure = map(json.loads, _lines(as_json=True))
    assert datetime.fromisoformat(event.pop("time")).utcoffset() is not None
    assert event == {"level": "warning", "source": "daemon.x", "message": "3 samples"}
    assert "ZeroDivisionError" in failure["traceback"]


def test_the_log_is_lines_of_text() -> None:
    event, *failure = _lines(as_json=False)
    assert event.endswith(" WARNING 3 samples")
    assert failure[-1] == "ZeroDivisionError: division by zero"
