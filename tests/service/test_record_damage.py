"""A record that cannot be written or read: nothing is lost, answers go on, and the reason is said."""

from pathlib import Path

import pytest

from beamtouch_service.record.events import boot_record
from service.record_file import execute
from service.recording import CONTACT, Services, ends, rounded


@pytest.mark.promise("docs/reference/http.md", "the record takes the rest when it comes again")
def test_of_a_boot_that_nothing_makes_durable_only_so_many_samples_wait(
    services: Services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, rows = tmp_path / "events.db", CONTACT * 6
    expected = rounded(services.straight(rows))
    monkeypatch.setattr(boot_record, "MAX_WAITING", 20)
    story = services.story(rows, path)
    execute(path, "CREATE TRIGGER full BEFORE INSERT ON cursors BEGIN SELECT RAISE(ABORT, 'disk full'); END")
    story.deliver(0, 15)
    receipt = story.deliver(15, 60)
    assert (receipt["durable"], receipt["expected"]) == (0, 21)
    assert (story.bench.contact()["state"], story.bench.contact()["sequence"]) == ("clear", 60)
    execute(path, "DROP TRIGGER full")
    while (receipt := story.ask())["durable"] != len(rows):
        story.backlog(receipt["expected"] - 1, len(rows))
        story.bench.get("/events")
    assert rounded(story.events) == expected


@pytest.mark.parametrize("table", ["events", "cursors"])
def test_events_and_cursor_are_written_together_or_not_at_all(services: Services, tmp_path: Path, table: str) -> None:
    path = tmp_path / "events.db"
    story = services.story(CONTACT, path)
    refusal = f"CREATE TRIGGER full BEFORE INSERT ON {table} BEGIN SELECT RAISE(ABORT, 'disk full'); END"
    execute(path, refusal)
    assert story.deliver(0, 5)["expected"] == 6
    assert story.events == []
    # Neither is there, for another service either.
    other = services.story(CONTACT, path)
    assert other.events == []
    assert (other.ask()["durable"], story.ask()["durable"]) == (0, 0)

    execute(path, "DROP TRIGGER full")
    assert ends(story) == [("touch", "open")]
    assert story.ask()["durable"] == 5
    story.catch_up()
    assert rounded(story.events) == rounded(services.straight(CONTACT))


@pytest.mark.promise(
    "docs/reference/problems.md",
    "Contacts go on, and daemons keep their samples. The answer has `Retry-After`.",
)
def test_while_the_record_is_damaged_answers_go_on_and_the_cursor_stands(
    services: Services, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    story = services.story(CONTACT, tmp_path / "events.db")
    story.deliver(0, 3)
    assert len(story.events) == 1
    for one in tmp_path.glob("events.db*"):
        one.write_bytes(b"no database" * 4096)
    receipt = story.deliver(3, 10)
    assert (receipt["durable"], receipt["expected"]) == (3, 11)
    refusal = story.bench.get("/events")
    assert (refusal.status_code, refusal.headers["retry-after"]) == (503, "1")
    assert refusal.json()["type"] == "urn:beamtouch:problem:record-unavailable"
    assert story.bench.contact()["state"] == "clear"
    assert story.ask()["durable"] == 3
    assert caplog.text.count("the record of events is away") == 1


@pytest.mark.promise("docs/reference/samples.md", "`durable` and `expected` are null while the record cannot be read.")
@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        ("UPDATE cursors SET memory = substr(memory, 2)", "table cursors, column memory: Extra data"),
        ("UPDATE cursors SET durable = 'abc'", "table cursors, column durable: Input should be a valid integer"),
        ("UPDATE events SET path = substr(path, 2)", "table events, column path: Extra data"),
        (
            "UPDATE events SET kind = 'bontact'",
            "table events, column kind: 'bontact' is not among the defined enum values",
        ),
        ("UPDATE events SET peak_force_n = 'abc'", "table events, column peak_force_n: Input should be a valid number"),
    ],
)
def test_a_row_that_cannot_be_read_is_said_like_any_damage(
    services: Services, tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str, reason: str
) -> None:
    path = tmp_path / "events.db"
    story = services.story(CONTACT, path)
    story.deliver(0, 3)
    assert ends(story) == [("touch", "open")]
    execute(path, damage)
    story = services.story(CONTACT, path)
    for first in range(3, 6):
        assert story.offer(first, first + 1)["durable"] is None
        assert story.bench.contact()["state"] == "contact"
    refusal = story.bench.get("/health/ready").json()
    row = "event 1" if "events" in damage else "the cursor of boot boot-0001"
    assert refusal["missing"]["events"].startswith(f"{row} of surface press-7 cannot be read: {reason}")
    assert story.bench.get("/events?path=true").status_code in {200, 503}
    assert caplog.text.count("the record of events is away") == 1
    assert "Traceback" not in caplog.text


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("peak_force_n", "'abc'"),
        ("touched_us", f"{2**60}"),
        ("samples", "'abc'"),
        ("place", "'{\"position\":[1]}'"),
        ("place", "'5'"),
        ("place", '\'{"position":["1",1,1,1,1,1]}\''),
        ("zones", "'[]'"),
        ("zones", "'{'"),
        ("end", "'lost'"),
        ("best", "'5'"),
        ("path", "'[[1]]'"),
        ("capture", "x'ff'"),
    ],
)
def test_each_damage_of_an_event_is_answered_with_its_row_and_leaves_the_others(
    services: Services, tmp_path: Path, caplog: pytest.LogCaptureFixture, column: str, value: str
) -> None:
    path = tmp_path / "events.db"
    story = services.story(CONTACT * 2, path)
    story.deliver(0, len(CONTACT) * 2)
    assert len(story.events) == 2
    execute(path, f"UPDATE events SET {column} = {value} WHERE id = 2")  # noqa: S608  # of this test
    assert story.bench.get("/events/1").is_success
    refusal = story.bench.get("/events/2")
    assert (refusal.status_code, refusal.headers["retry-after"]) == (503, "1")
    assert refusal.json()["detail"].startswith(
        f"event 2 of surface press-7 cannot be read: table events, column {column}: "
    )
    assert story.bench.get("/events?path=true").status_code == 503
    short = {story.bench.get(f"/events?format={one}").status_code for one in ("json", "csv")}
    assert short == ({200} if column in {"best", "path", "capture"} else {503})
    assert "Traceback" not in caplog.text


def test_numbers_of_an_event_are_damaged_from_where_json_holds_none_exactly(services: Services, tmp_path: Path) -> None:
    path, most = tmp_path / "events.db", 2**53
    story = services.story(CONTACT, path)
    story.deliver(0, len(CONTACT))
    assert len(story.events) == 1
    times = [(most - 1, True), (most, False), (-most, True), (-most - 2, False), (0, True)]
    counts = [(most - 1, True), (most, False), (-1, False), (0, True)]
    cases = [(column, str(value), is_whole) for column in ("touched_us", "last_us") for value, is_whole in times]
    cases += [("samples", str(value), is_whole) for value, is_whole in counts]
    cases += [("path", f"'[[0,1,0,{value},{value},{value}]]'", is_whole) for value, is_whole in times]
    for column, value, is_whole in cases:
        execute(path, f"UPDATE events SET {column} = {value}")  # noqa: S608  # of this test
        found = story.bench.get("/events/1").is_success
        assert found is is_whole, (column, value)


@pytest.mark.parametrize("is_replaced", [False, True])
def test_a_record_that_is_deleted_begins_anew_with_what_the_sender_keeps(
    services: Services, tmp_path: Path, *, is_replaced: bool
) -> None:
    path = tmp_path / "events.db"
    story = services.story(CONTACT, path)
    story.deliver(0, 3)
    assert len(story.events) == 1
    for one in tmp_path.glob("events.db*"):
        one.unlink()
    if is_replaced:
        path.touch()
    story.oldest = 4
    story.deliver(3, 5)
    story.bench.get("/events")  # the cursor is gone
    story.ask()
    story.catch_up()
    assert ends(story) == [("unseen", "lift")]
    assert story.ask()["durable"] == 10
