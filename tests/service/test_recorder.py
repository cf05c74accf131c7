"""Samples that wait to be recorded: limited, refused above the limit, and dropped at a stop."""

from __future__ import annotations

from threading import Event, Thread
from typing import TYPE_CHECKING, Any

import pytest

from beamtouch_service.events.late_queue import MAX_LATE
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.events.segments import MAX_POINTS
from service.event_story import RESTING, TOUCHING, Row, settle

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from service.conftest import Bench, MakeBatch

NEWEST = 10_000_000
ROWS: list[Row] = [*[TOUCHING] * 999, RESTING] * 2


@pytest.fixture
def recorder(bench: Bench) -> Recorder:
    assert bench.app.context.recorder is not None
    return bench.app.context.recorder


@pytest.fixture
def gate(recorder: Recorder) -> Iterator[Event]:
    """Nothing is written until it is set, as if the disk hung."""
    gate = Event()
    recorder.ask(lambda _: gate.wait(60))
    yield gate
    gate.set()


def fill(bench: Bench, make_batch: MakeBatch) -> list[dict[str, Any]]:
    """Post late batches until one is refused; return all of them."""
    bench.post(make_batch(RESTING, sequence=NEWEST))
    sent: list[dict[str, Any]] = []
    while len(sent) < 50:
        sent.append(make_batch(*ROWS, sequence=len(ROWS) * len(sent), age_ms=60_000))
        if bench.post(sent[-1]).status_code != 200:
            return sent
    message = "no batch was refused"
    raise AssertionError(message)


def test_late_samples_above_the_limit_are_refused_until_there_is_room(
    bench: Bench, make_batch: MakeBatch, recorder: Recorder, gate: Event
) -> None:
    sent = fill(bench, make_batch)
    refusal = bench.post(sent[-1])

    assert len(ROWS) * (len(sent) - 1) == recorder.late_waiting == MAX_LATE
    assert (refusal.status_code, refusal.headers["retry-after"]) == (503, "1")
    assert refusal.json()["type"] == "urn:beamtouch:problem:busy"
    assert "send the batch again" in refusal.json()["detail"]

    gate.set()
    settle(bench)
    assert bench.post(sent[-1]).json() == {"accepted": len(ROWS), "repeated": 0}
    settle(bench)
    events = bench.get("/events?limit=1000").json()["events"]
    assert (len(events), sum(event["samples"] for event in events)) == (2 * len(sent), 1998 * len(sent))
    assert recorder.lost == 0


def test_a_batch_with_a_new_sample_is_accepted_above_the_limit(
    bench: Bench, make_batch: MakeBatch, recorder: Recorder, gate: Event
) -> None:
    fill(bench, make_batch)
    assert bench.post(make_batch(TOUCHING, sequence=NEWEST + 2)).status_code == 200
    mixed = make_batch(TOUCHING, TOUCHING, TOUCHING, sequence=NEWEST + 1)

    assert bench.post(mixed).json() == {"accepted": 2, "repeated": 1}
    assert bench.get("/contact").json()["sequence"] == NEWEST + 3
    assert recorder.late_waiting == MAX_LATE + 1
    gate.set()
    settle(bench)
    found = [event for event in bench.get("/events?limit=1000").json()["events"] if event["samples"] < 999]
    assert [(event["samples"], event["begin"], event["end"]) for event in found] == [(3, "touch", "open")]
    assert recorder.lost == 0


def test_above_twice_the_limit_late_samples_are_lost(
    bench: Bench, make_batch: MakeBatch, recorder: Recorder, gate: Event
) -> None:
    bench.post(make_batch(RESTING, sequence=0))
    for number in range(1, 30):
        # A new sample first, then the ones before it together with another new one.
        bench.post(make_batch(TOUCHING, sequence=4000 * number))
        body = make_batch(*[TOUCHING] * 2000, sequence=4000 * number - 1998)
        assert bench.post(body).json() == {"accepted": 1999, "repeated": 1}

    assert 2 * MAX_LATE < recorder.late_waiting <= 2 * MAX_LATE + 2000
    assert recorder.lost > 0
    gate.set()


def test_a_long_contact_keeps_a_path_of_bounded_length(bench: Bench, make_batch: MakeBatch) -> None:
    for number in range(3):
        bench.post(make_batch(*[TOUCHING] * 900, sequence=1 + 900 * number))
    bench.post(make_batch(RESTING, sequence=2701))
    (event,) = bench.get("/events?path=true").json()["events"]
    assert (event["samples"], event["end"]) == (2700, "lift")
    assert 2 < len(event["path"]) <= MAX_POINTS
    assert len({point["at"] for point in event["path"]}) == len(event["path"])


def test_writes_beyond_what_a_slow_disk_may_owe_are_lost_and_leave_no_event_open(
    bench: Bench, make_batch: MakeBatch, recorder: Recorder, gate: Event, caplog: pytest.LogCaptureFixture
) -> None:
    contacts = 600  # each is written at its touch and at its lift
    for number in range(contacts):
        for row in (TOUCHING, RESTING):
            bench.post(make_batch(row, sequence=2 * number + (row is RESTING)))
    assert "events are lost: the disk is too slow" in caplog.text
    assert recorder.lost > 0
    gate.set()

    after = 2 * contacts
    bench.post(make_batch(TOUCHING, sequence=after))
    bench.post(make_batch(RESTING, sequence=after + 1))
    events = bench.get("/events?limit=1000").json()["events"]
    assert (events[0]["begin"], events[0]["end"]) == ("touch", "lift")
    assert 400 < len(events) <= contacts
    assert all(event["end"] != "open" for event in events)


def test_a_stop_does_not_wait_for_late_samples_and_counts_them_as_lost(
    bench: Bench,
    make_batch: MakeBatch,
    recorder: Recorder,
    gate: Event,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    sent = fill(bench, make_batch)
    monkeypatch.setattr("beamtouch_service.events.recorder.STOP_S", 0.0)
    stop = Thread(target=recorder.close)
    stop.start()
    gate.set()
    stop.join(60)

    assert not stop.is_alive()
    # The late batches, and the write of the newest sample behind the gate.
    assert recorder.lost == len(sent) - 1 + 1
    assert f"{recorder.lost} writes were lost at the stop" in caplog.text


def test_a_stop_writes_late_samples_while_it_has_time(
    bench: Bench, make_batch: MakeBatch, recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.post(make_batch(RESTING, sequence=NEWEST))
    for number in range(3):
        bench.post(make_batch(*ROWS, sequence=len(ROWS) * number, age_ms=60_000))
    monkeypatch.setattr("beamtouch_service.events.recorder.STOP_S", 60.0)
    recorder.close()

    assert (recorder.late_waiting, recorder.lost) == (0, 0)


def test_a_deleted_file_is_logged_and_counted_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recorder = Recorder(tmp_path / "events.db")
    recorder.tidy()
    assert (recorder.lost, caplog.records) == (0, [])
    (tmp_path / "events.db").unlink()
    recorder.tidy()
    recorder.tidy()
    recorder.close()

    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert "was deleted or replaced" in caplog.text
    assert recorder.lost == 1
