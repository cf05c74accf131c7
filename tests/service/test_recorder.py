"""What waits to be put on record: bounded, refused before it is too much, and not waited for at a stop."""

from __future__ import annotations

from threading import Event, Thread
from typing import TYPE_CHECKING, Any

import pytest

from beamtouch_service.events import recorder as recorder_module
from beamtouch_service.events.recorder import MOST_LATE, Recorder
from service.test_events import RESTING, TOUCHING, Row, settle

if TYPE_CHECKING:
    from collections.abc import Iterator

    from service.conftest import Bench, MakeBatch

PRESENT = 10_000_000
ROWS: list[Row] = [*[TOUCHING] * 999, RESTING] * 2


@pytest.fixture
def recorder(bench: Bench) -> Recorder:
    assert bench.app.context.recorder is not None
    return bench.app.context.recorder


@pytest.fixture
def gate(recorder: Recorder) -> Iterator[Event]:
    """Until it is set, nothing is written: a disk that hangs."""
    gate = Event()
    recorder.ask(lambda _: gate.wait(60))
    yield gate
    gate.set()


def fill(bench: Bench, make_batch: MakeBatch) -> list[dict[str, Any]]:
    """Post late batches until one is refused; return all of them."""
    bench.post(make_batch(RESTING, sequence=PRESENT))
    sent: list[dict[str, Any]] = []
    while len(sent) < 50:
        sent.append(make_batch(*ROWS, sequence=len(ROWS) * len(sent), age_ms=60_000))
        if bench.post(sent[-1]).status_code != 200:
            return sent
    message = "none was refused"
    raise AssertionError(message)


def test_late_samples_without_room_are_refused_and_are_new_when_they_are_sent_again(
    bench: Bench, make_batch: MakeBatch, recorder: Recorder, gate: Event
) -> None:
    sent = fill(bench, make_batch)
    refusal = bench.post(sent[-1])

    assert len(ROWS) * (len(sent) - 1) == recorder.late_waiting == MOST_LATE
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


def test_a_batch_with_a_present_sample_is_taken_whole_however_much_waits(
    bench: Bench, make_batch: MakeBatch, recorder: Recorder, gate: Event
) -> None:
    fill(bench, make_batch)
    assert bench.post(make_batch(TOUCHING, sequence=PRESENT + 2)).status_code == 200
    mixed = make_batch(TOUCHING, TOUCHING, TOUCHING, sequence=PRESENT + 1)

    assert bench.post(mixed).json() == {"accepted": 2, "repeated": 1}
    assert bench.get("/contact").json()["sequence"] == PRESENT + 3
    assert recorder.late_waiting == MOST_LATE + 1
    gate.set()
    settle(bench)
    found = [event for event in bench.get("/events?limit=1000").json()["events"] if event["samples"] < 999]
    assert [(event["samples"], event["begin"], event["end"]) for event in found] == [(3, "touch", "open")]
    assert recorder.lost == 0


def test_without_end_not_even_that(bench: Bench, make_batch: MakeBatch, recorder: Recorder, gate: Event) -> None:
    bench.post(make_batch(RESTING, sequence=0))
    for number in range(1, 30):
        # Its last sample is present; then the ones before come, and a present one again.
        bench.post(make_batch(TOUCHING, sequence=4000 * number))
        body = make_batch(*[TOUCHING] * 2000, sequence=4000 * number - 1998)
        assert bench.post(body).json() == {"accepted": 1999, "repeated": 1}

    assert 2 * MOST_LATE < recorder.late_waiting <= 2 * MOST_LATE + 2000
    assert recorder.lost > 0
    gate.set()


def test_a_stop_does_not_wait_for_what_is_late_and_counts_it(
    bench: Bench,
    make_batch: MakeBatch,
    recorder: Recorder,
    gate: Event,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    sent = fill(bench, make_batch)
    monkeypatch.setattr(recorder_module, "STOP_S", 0.0)
    stop = Thread(target=recorder.close)
    stop.start()
    gate.set()
    stop.join(60)

    assert not stop.is_alive()
    # And the write of the present that stood behind the gate.
    assert recorder.lost == len(sent) - 1 + 1
    assert f"{recorder.lost} writes were lost at the stop" in caplog.text


def test_a_stop_writes_what_it_has_time_for(
    bench: Bench, make_batch: MakeBatch, recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.post(make_batch(RESTING, sequence=PRESENT))
    for number in range(3):
        bench.post(make_batch(*ROWS, sequence=len(ROWS) * number, age_ms=60_000))
    monkeypatch.setattr(recorder_module, "STOP_S", 60.0)
    recorder.close()

    assert (recorder.late_waiting, recorder.lost) == (0, 0)
