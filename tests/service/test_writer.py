"""When the writer of the record says that it is away, why, and how often the log does."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.record.writing.writer import Writer
from beamtouch_service.sections import EventsSection


@pytest.fixture
def writer() -> Iterator[Writer]:
    one = Writer(Transactions(EventsSection()))
    yield one
    one.end()


def test_a_record_that_cannot_be_opened_is_away_from_the_start(tmp_path: Path) -> None:
    transactions = Transactions(EventsSection(file=tmp_path / "nowhere" / "events.db"))
    one = Writer(transactions)
    assert (one.is_away, one.reason, one.outages) == (True, transactions.away_because, 1)
    one.end()


AWAY = "the record of events is away: {}; answers go on, and daemons keep their samples"
BACK = "the record of events is back after "


def test_an_outage_is_said_at_its_begin_and_at_its_end_and_counted(
    writer: Writer, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    writer.note("")
    assert (writer.is_away, writer.reason, writer.outages, caplog.messages) == (False, "", 0, [])
    for reason in ("disk full", "disk full", "no route"):
        writer.note(reason)
        assert (writer.is_away, writer.reason, writer.outages) == (True, reason, 1)
    writer.note("")
    assert (writer.is_away, writer.outages) == (False, 1)
    first, second = caplog.messages
    assert (first, second.startswith(BACK)) == (AWAY.format("disk full"), True)
    writer.note("no route")
    assert writer.outages == 2


def test_a_surface_whose_rows_are_damaged_is_a_reason_and_the_rest_goes_on(
    writer: Writer, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    writer.note_damage("press-7", "a row")
    writer.note_damage("press-8", "another row")
    assert (writer.is_away, writer.reason, writer.outages) == (False, "a row", 1)
    writer.note_damage("press-7", "the same row")  # the newest comes last
    assert writer.reason == "another row"
    writer.note("disk full")
    assert writer.reason == "disk full"  # that of all comes first
    writer.note("")
    writer.note_damage("press-8")
    writer.note_damage("press-9")
    assert (writer.reason, writer.outages) == ("the same row", 1)
    writer.note_damage("press-7")
    assert (writer.reason, len(caplog.messages)) == ("", 2)


def test_an_error_that_is_not_expected_is_logged_with_its_traceback_once_a_minute(
    writer: Writer, caplog: pytest.LogCaptureFixture
) -> None:
    for error in (KeyError("a"), KeyError("a"), KeyError("b")):
        writer.note_unexpected("commit", error)
        assert (writer.is_away, writer.reason) == (True, f"unexpected error ({error!r})")
    said = [record.getMessage() for record in caplog.records if record.exc_info]
    assert said == ["the record cannot be read or written"] * 2
    assert writer.outages == 1


def test_a_work_that_failed_is_a_reason_until_it_succeeds_whatever_others_do(
    writer: Writer, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    writer.note_unexpected("upkeep", KeyError("a"))
    writer.note("")
    writer.note_success("commit")
    assert (writer.is_away, writer.reason, writer.outages) == (False, "unexpected error (KeyError('a'))", 1)
    writer.note_success("upkeep")
    assert (writer.is_away, writer.reason, writer.outages) == (False, "", 1)
    assert caplog.messages[-1].startswith(BACK)
