"""The trail: who changed what and when; the next page, the table, the chain, and what a hand in the database leaves."""

import csv
import io
import os
import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import pytest
from fastapi.testclient import TestClient

from beamtouch_service.access import Access
from beamtouch_service.api.changes import make_entry, note_model
from beamtouch_service.record import Action
from beamtouch_service.record.trail import pending
from beamtouch_service.record.trail.entry import Entry
from beamtouch_service.sections import EventsSection
from service.bench import Bench, batch_of, kind, surface_of
from service.event_story import RESTING
from service.read_tables import tables_read
from service.record_file import execute
from support.surfaces.small_model import model_of

HALL, SPARE, ANN = "hall-horse-battery-staple", "spare-horse-battery-staple", "ann-horse-battery-staple"
ACCESS = Access(write={"hall": HALL, "spare": SPARE}, admin={"ann": ANN})
TARED_AT = "2026-11-20T21:00:00+00:00"


def make_bench(where: Path | str | None = None) -> Bench:
    events = EventsSection(url=where) if isinstance(where, str) else EventsSection(file=where)
    return Bench(surface_of(), access=ACCESS, events=events)


def send(bench: Bench, token: str, characteristic: str, tared_at: str | None = None, *, sequence: int = 1) -> None:
    """Send a batch of a daemon with these rest gaps, a minute after the one before, and do what each second does."""
    bench.now_s += 61
    said = {"characteristic": characteristic, "tared_at": tared_at}
    answer = bench.post(batch_of(RESTING, sequence=sequence) | said, token=token)
    assert answer.status_code == 200, answer.text
    (surface,) = bench.app.context.registry
    note_model(bench.app.context, surface)
    bench.pass_second()


def audit(bench: Bench, query: str = "") -> dict[str, Any]:
    answer = bench.get(f"/audit{query}", ANN)
    assert answer.status_code == 200, answer.text
    page: dict[str, Any] = answer.json()
    return page


def said(bench: Bench, query: str = "") -> list[tuple[Any, ...]]:
    """Return number, action, surface, who, and what else of each entry, oldest first."""
    entries = audit(bench, query)["entries"][::-1]
    return [tuple(one[name] for name in ("number", "action", "surface", "by", "details")) for one in entries]


def change(bench: Bench) -> None:
    """Make nine changes with three tokens."""
    send(bench, HALL, "c1", TARED_AT)
    send(bench, HALL, "c2", "2026-11-21T05:00:00+00:00", sequence=2)
    bench.adopt(model_of(name="press-8"))
    send(bench, SPARE, "c2", "2026-11-21T05:00:00+00:00", sequence=3)
    bench.post(b"", "/surfaces/press-7/commissioning", ANN)
    run = bench.get("/surfaces/press-7/commissioning").json()["run"]["id"]
    bench.post(b"", f"/surfaces/press-7/commissioning/abandon?run={run}", ANN)
    bench.pass_second()


def of_model(number: int, name: str) -> tuple[Any, ...]:
    return number, "model", "press-7", "service", {"model": model_of(name=name).identity}


@pytest.fixture(params=["file", "database"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    found: Path | str = tmp_path / "events.db" if request.param == "file" else request.getfixturevalue("events_url")
    return found


def test_each_change_is_on_the_trail_with_who_made_it(place: Path | str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    bench = make_bench(place)
    change(bench)
    tare = {"characteristic": "c2", "tared_at": "2026-11-21T05:00:00+00:00"}
    wanted = [
        (1, "token", None, "hall", {}),
        (2, "tare", "press-7", "hall", {"characteristic": "c1", "tared_at": TARED_AT}),
        of_model(3, "press-7"),
        (4, "tare", "press-7", "hall", tare),
        (5, "token", None, "spare", {}),
        of_model(6, "press-8"),
        (7, "token", None, "ann", {}),
        (8, "commissioning", "press-7", "ann", {"step": "begun"}),
        (9, "commissioning", "press-7", "ann", {"step": "abandoned"}),
    ]
    assert said(bench) == wanted
    page = audit(bench)
    assert page["chain"] == {
        "holds": True,
        "breaks_at": None,
        "entries": 9,
        "digest": page["entries"][0]["digest"],
    }
    assert {one["address"] for one in page["entries"] if one["by"] != "service"} == {"testclient"}
    # The log has each digest, out of reach of the database.
    assert [one["digest"] for one in page["entries"][::-1]] == [
        line.rpartition(" ")[2] for line in caplog.messages if line.startswith("trail: entry")
    ]
    for secret in (HALL, SPARE, ANN):
        assert secret not in bench.get("/audit", ANN).text + caplog.text


@pytest.mark.promise("docs/reference/trail.md", "A state that has not changed is not told again after a restart.")
def test_a_restart_and_a_second_service_say_nothing_twice(place: Path | str) -> None:
    first = make_bench(place)
    send(first, HALL, "c1")
    second = make_bench(place)
    send(second, HALL, "c1", sequence=2)
    send(first, HALL, "c2", sequence=3)
    send(second, HALL, "c3", sequence=4)
    assert [(action, details) for _, action, _, _, details in said(second)][3:] == [
        ("tare", {"characteristic": "c2", "tared_at": None}),
        ("tare", {"characteristic": "c3", "tared_at": None}),
    ]
    assert audit(first)["chain"] == audit(second)["chain"]
    assert audit(first)["chain"]["holds"]


def test_the_next_page_and_the_table_have_the_same_entries() -> None:
    bench = make_bench()
    change(bench)
    whole, pages, after = audit(bench)["entries"], [], ""
    while True:
        page = audit(bench, f"?limit=4{after}")
        pages += page["entries"]
        assert (page["chain"] is None) == bool(after)
        if page["next"] is None:
            break
        after = f"&after={page['next']}"
    assert pages == whole
    answer = bench.get("/audit?format=csv&limit=4&surface=press-7", ANN)
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert [row["number"] for row in rows] == ["9", "8", "6", "4"]
    assert answer.headers["link"] == '<?format=csv&limit=4&surface=press-7&after=4>; rel="next"'
    following = bench.get(f"/audit{answer.headers['link'].split('>')[0].strip('<')}", ANN)
    assert [row["number"] for row in csv.DictReader(io.StringIO(following.text))] == ["3", "2"]
    assert "link" not in following.headers
    assert [row["details"] for row in rows[:2]] == ['{"step":"abandoned"}', '{"step":"begun"}']


def test_entries_of_a_kind_and_of_a_time() -> None:
    bench = make_bench()
    change(bench)
    assert [number for number, *_ in said(bench, "?action=model")] == [3, 6]
    assert said(bench, "?since=2999-01-01T00:00:00Z") == []
    assert len(said(bench, "?until=2999-01-01T00:00:00Z")) == 9
    assert kind(bench.get("/audit?action=nothing", ANN)) == "invalid-request"
    assert kind(bench.get("/audit?after=x", ANN)) == "invalid-request"


def test_head_checks_no_chain() -> None:
    bench = make_bench()
    change(bench)
    with tables_read() as tables:
        head = bench.client.head("/audit", headers={"Authorization": f"Bearer {ANN}"})
        assert (head.status_code, tables) == (200, ["trail"])
        whole = bench.get("/audit", ANN)
        assert (head.headers, head.content) == (whole.headers, b"")
        assert tables == ["trail"] * 4


EDITS = {
    "a word of an entry": ("UPDATE trail SET by = 'bob' WHERE number = 4", 4),
    "its time": ("UPDATE trail SET at_us = at_us + 1 WHERE number = 1", 1),
    "its details": ("UPDATE trail SET details = '{}' WHERE number = 9", 9),
    "its digest": ("UPDATE trail SET digest = 'x' WHERE number = 4", 4),
    "one that is taken out": ("DELETE FROM trail WHERE number = 5", 6),
    "the first ones": ("DELETE FROM trail WHERE number < 3", 3),
    "one that is put in": ("INSERT INTO trail SELECT 10, at_us, action, '', '', '', '', '', '', digest FROM trail", 10),
}


@pytest.mark.promise("docs/reference/trail.md", "`GET /audit` says where the chain breaks")
@pytest.mark.parametrize("edit", EDITS)
def test_an_entry_that_is_edited_by_hand_is_noticed_and_named(tmp_path: Path, edit: str) -> None:
    bench = make_bench(tmp_path / "events.db")
    change(bench)
    statement, breaks_at = EDITS[edit]
    execute(tmp_path / "events.db", statement + (" LIMIT 1" if "INSERT" in statement else ""))
    chain = audit(bench)["chain"]
    assert (chain["holds"], chain["breaks_at"]) == (False, breaks_at)
    # The trail goes on behind it, and the break stays.
    send(bench, HALL, "c9", sequence=9)
    assert audit(bench)["chain"]["breaks_at"] == breaks_at


@pytest.mark.promise("docs/reference/trail.md", "The last entries can be taken out unnoticed")
def test_the_last_entries_can_be_taken_out_and_only_a_digest_elsewhere_tells(tmp_path: Path) -> None:
    bench = make_bench(tmp_path / "events.db")
    change(bench)
    kept = audit(bench)["chain"]
    execute(tmp_path / "events.db", "DELETE FROM trail WHERE number > 7")
    assert audit(bench)["chain"]["holds"]
    assert audit(bench)["chain"]["digest"] != kept["digest"]


@pytest.mark.promise("docs/reference/trail.md", "An entry whose row is damaged stands in `damaged`")
def test_a_damaged_entry_is_named_beside_the_others(tmp_path: Path) -> None:
    bench = make_bench(tmp_path / "events.db")
    change(bench)
    before = audit(bench)["entries"]
    execute(tmp_path / "events.db", "UPDATE trail SET at_us = 'x' WHERE number = 4")
    page = audit(bench)
    assert page["entries"] == [one for one in before if one["number"] != 4]
    ((number, reason),) = (one.values() for one in page["damaged"])
    assert number == 4
    assert reason.startswith("entry 4 of the trail cannot be read: table trail, column at_us: ")
    assert (page["chain"]["holds"], page["chain"]["breaks_at"]) == (False, 4)
    # It takes its place in a page.
    page = audit(bench, "?after=6&limit=2")
    assert ([one["number"] for one in page["entries"]], page["next"]) == ([5], "4")
    rows = list(csv.DictReader(io.StringIO(bench.get("/audit?format=csv", ANN).text)))
    assert [row["number"] for row in rows] == [str(number) for number in range(9, 0, -1)]
    assert (rows[5]["at"], rows[5]["details"]) == ("", reason)


def test_a_record_that_takes_nothing_gets_the_changes_once_it_does(tmp_path: Path) -> None:
    """Read-only as to a write: another program holds the lock."""
    bench = make_bench(tmp_path / "events.db")
    bench.pass_second()
    with closing(sqlite3.connect(tmp_path / "events.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        answer = bench.post(batch_of(RESTING) | {"characteristic": "c1"}, token=HALL)
        bench.pass_second()
        assert answer.status_code == 200
        assert "database is locked" in bench.app.context.recorder.away_because
        assert said(bench) == []
        other.execute("ROLLBACK")
    bench.pass_second()
    assert [action for _, action, *_ in said(bench)] == ["token", "tare"]
    assert bench.app.context.recorder.away_because == ""


def test_a_record_that_is_replaced_begins_a_trail_with_what_holds(tmp_path: Path) -> None:
    bench = make_bench(tmp_path / "events.db")
    send(bench, HALL, "c1")
    for path in tmp_path.glob("events.db*"):
        path.unlink()
    for sequence in (2, 3):
        send(bench, HALL, "c2", sequence=sequence)
    assert {action for _, action, *_ in said(bench)} == {"token", "tare", "model"}
    assert audit(bench)["chain"]["holds"]


@pytest.mark.promise("docs/reference/trail.md", "at most once a minute")
def test_two_daemons_that_send_in_turn_do_not_fill_the_trail() -> None:
    bench = make_bench()
    for sequence in range(1, 21):
        characteristic = f"c{sequence % 2}"
        bench.post(batch_of(RESTING, sequence=sequence) | {"characteristic": characteristic}, token=HALL)
        bench.now_s += 5
    bench.pass_second()
    assert [action for _, action, *_ in said(bench)].count("tare") == 3


def test_more_changes_than_can_be_kept_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pending, "MOST_DUE", 2)
    bench = make_bench()
    bench.post(batch_of(RESTING) | {"characteristic": "c1"}, token=HALL)
    for _ in range(2):
        bench.post(b"", "/surfaces/press-7/commissioning", ANN)
        run = bench.get("/surfaces/press-7/commissioning").json()["run"]["id"]
        bench.post(b"", f"/surfaces/press-7/commissioning/abandon?run={run}", ANN)
    for _ in range(2):
        bench.pass_second()
    *_, (_, action, _, _, details) = said(bench)
    assert (action, details["entries"]) == ("loss", 4)


def test_more_addresses_than_are_watched_are_told_once_an_hour(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pending, "MOST_STATES", 1)
    bench = make_bench()
    send(bench, HALL, "c1")
    for sequence, token in enumerate((SPARE, HALL, SPARE), 2):
        send(bench, token, "c2", sequence=sequence)
    # One address more than are watched keeps neither a model nor a tare from being told.
    told = [(action, by) for _, action, _, by, _ in said(bench)]
    assert told == [("token", "hall"), ("tare", "hall"), ("model", "service"), ("tare", "spare"), ("loss", "service")]


@pytest.mark.promise("docs/reference/trail.md", "While the record is away, a thousand entries wait in memory")
def test_a_trail_that_takes_nothing_is_one_outage_and_samples_are_still_taken(tmp_path: Path) -> None:
    bench = make_bench(tmp_path / "events.db")
    send(bench, HALL, "c1")
    execute(tmp_path / "events.db", "ALTER TABLE trail RENAME TO elsewhere")
    recorder = bench.app.context.recorder
    for sequence in (2, 3, 4):
        send(bench, HALL, f"c{sequence}", sequence=sequence)
        assert (recorder.away_because, recorder.outages) == ("no such table: trail", 1)
    execute(tmp_path / "events.db", "ALTER TABLE elsewhere RENAME TO trail")
    bench.pass_second()
    assert (recorder.away_because, recorder.outages) == ("", 1)
    assert [details["characteristic"] for *_, details in said(bench, "?action=tare")] == ["c1", "c2", "c3", "c4"]
    assert audit(bench)["chain"]["holds"]


def test_a_path_that_is_no_text_does_not_hold_up_the_trail(place: Path | str) -> None:
    bench = make_bench(place)
    start = make_entry(Action.START, {"options": {"model": os.fsdecode(b"\xff.onnx")}})
    bench.app.context.recorder.trail.note(start)
    send(bench, HALL, "c1")
    assert said(bench)[0] == (1, "start", None, "service", {"options": {"model": "?.onnx"}})


def ask(bench: Bench, peer: str, headers: Iterable[tuple[str, str]]) -> httpx2.Response:
    """Send a batch over a connection from this address."""
    client = TestClient(bench.app, client=(peer, 50_000), raise_server_exceptions=False)
    client.portal = Bench.event_loop
    named = [*headers, ("Authorization", f"Bearer {HALL}")]
    encoded = [(name.encode(), value.encode()) for name, value in named]
    return client.post("/surfaces/press-7/samples", json=batch_of(), headers=encoded)


@pytest.mark.promise("docs/reference/trail.md", "believed only if the connection comes from `server.trusted_proxies`")
@pytest.mark.parametrize(
    ("peer", "headers", "who"),
    [
        ("10.0.0.5", {"X-Forwarded-User": "bea", "X-Forwarded-For": "1.1.1.1, 10.9.0.7"}, ("bea", "hall", "10.9.0.7")),
        ("10.0.0.5", {"X-Forwarded-User": "b\u00e9a\t x"}, ("béa x", "hall", "10.0.0.5")),
        ("10.0.0.5", {"X-Forwarded-User": "x" * 200}, ("x" * 80, "hall", "10.0.0.5")),
        ("10.0.0.5", {"X-Forwarded-User": " "}, ("hall", "hall", "10.0.0.5")),
        ("10.0.0.5", {"X-Forwarded-User": "Service"}, ("hall", "hall", "10.0.0.5")),
        ("10.0.0.6", {"X-Forwarded-User": "bea", "X-Forwarded-For": "10.9.0.7"}, ("hall", "hall", "10.0.0.6")),
        ("::ffff:10.0.0.5", {"X-Forwarded-User": "bea"}, ("bea", "hall", "::ffff:10.0.0.5")),
        ("fd00::5", {"X-Forwarded-User": "bea", "X-Forwarded-For": "fd00::9"}, ("bea", "hall", "fd00::9")),
        ("fd01::5", {"X-Forwarded-User": "bea"}, ("hall", "hall", "fd01::5")),
        ("10.0.1.5", {}, ("hall", "hall", "10.0.1.5")),
    ],
)
def test_a_user_is_believed_from_a_trusted_proxy_only(
    peer: str, headers: dict[str, str], who: tuple[str, str, str]
) -> None:
    bench = Bench(surface_of(), access=ACCESS, proxies=["10.0.0.5", "10.0.1.0/24", "fd00::/64"])
    assert ask(bench, peer, headers.items()).status_code == 200
    bench.pass_second()
    (entry,) = audit(bench, "?action=token&limit=1")["entries"]
    assert (entry["by"], entry["token"], entry["address"]) == who


@pytest.mark.parametrize(
    ("headers", "by", "address"),
    [
        ([("X-Forwarded-User", "bea"), ("X-Forwarded-User", "ann")], "hall", "10.0.0.5"),
        ([("X-Forwarded-For", "1.1.1.1"), ("X-Forwarded-For", "10.9.0.7")], "hall", "10.9.0.7"),
        ([("X-Forwarded-For", "1.1.1.1,2.2.2.2,10.9.0.7")], "hall", "10.9.0.7"),
        ([("X-Forwarded-For", "x" * 81)], "hall", "x" * 80),
    ],
    ids=["two users", "two addresses", "a chain", "a long one"],
)
def test_of_headers_that_a_client_may_have_sent_too_that_of_the_proxy_counts(
    headers: list[tuple[str, str]], by: str, address: str
) -> None:
    bench = Bench(surface_of(), access=ACCESS, proxies=["10.0.0.5"])
    assert ask(bench, "10.0.0.5", headers).status_code == 200
    bench.pass_second()
    (entry,) = audit(bench, "?action=token&limit=1")["entries"]
    assert (entry["by"], entry["address"]) == (by, address)


def test_a_token_that_only_reads_is_on_no_trail() -> None:
    bench = make_bench()
    for _ in range(2):
        assert said(bench) == []
        bench.pass_second()


def test_another_record_gets_each_state_once() -> None:
    trail = pending.PendingTrail()

    def note(action: Action) -> None:
        trail.note_state(action, "", "", 1, 0.0, lambda: Entry(1, action, "{}"))

    note(Action.TARE)
    assert [entry.action for entry in trail.take_due(0.0)] == [Action.TARE]
    note(Action.MODEL)
    written = trail.take_due(0.0)
    note(Action.TOKEN)  # while the first entry of the new record is written
    trail.forget_states(but=written)
    for action in (Action.TARE, Action.MODEL, Action.TOKEN):
        note(action)
    assert [entry.action for entry in trail.take_due(0.0)] == [Action.TOKEN, Action.TARE]
