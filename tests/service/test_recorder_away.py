"""The recorder while its database fails, hangs or is damaged: when it counts as away, and until when."""

import asyncio
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from beamtouch_service.record import recorder
from beamtouch_service.record.database.errors import RecordAwayError, UnreadableRowError
from beamtouch_service.record.recorder import Recorder
from beamtouch_service.sections import EventsSection
from service.bench import surface_of
from service.event_story import RESTING, TOUCHING
from service.record_file import execute
from service.recorder_bench import PATIENT_S, REST, batch_of, commit, recording, take

pytestmark = pytest.mark.anyio


def breaking(monkeypatch: pytest.MonkeyPatch, one: Recorder, call: str, error: Exception) -> Callable[[], None]:
    """Let a transaction raise an error; return what ends that."""

    def fail(*_: object) -> None:
        raise error

    works = getattr(one.transactions, call)
    monkeypatch.setattr(one.transactions, call, fail)
    return lambda: monkeypatch.setattr(one.transactions, call, works)


ERRORS = [
    (RecordAwayError("no route"), "no route"),
    (UnreadableRowError("a row is damaged"), "a row is damaged"),
    (RuntimeError("bug"), "unexpected error (RuntimeError('bug'))"),
]


@pytest.mark.parametrize(("error", "reason"), ERRORS)
async def test_a_boot_that_cannot_be_read_makes_the_record_away_until_it_is(
    monkeypatch: pytest.MonkeyPatch, error: Exception, reason: str
) -> None:
    monkeypatch.setattr(recorder, "REST_S", 0.0)
    surface = surface_of()
    async with recording() as one:
        mend = breaking(monkeypatch, one, "load", error)
        assert await one.take(surface, batch_of(*REST), {}) == (None, None)
        await asyncio.sleep(0)
        assert (one.away_because, one.outages) == (reason, 1)
        mend()
        assert await take(one, surface, *REST) == (0, 4)
        # Others than that of a row may hold what is written, too.
        assert one.away_because == ("" if isinstance(error, UnreadableRowError) else reason)
        await commit(one)
        assert (one.away_because, one.outages) == ("", 1)


@pytest.mark.parametrize("error", [error for error, _ in ERRORS])
async def test_a_boot_that_cannot_be_read_is_not_read_with_each_batch(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    now = SimpleNamespace(s=100.0)
    asked: list[str] = []
    monkeypatch.setattr(recorder, "time", SimpleNamespace(monotonic=lambda: now.s, time=lambda: 1.8e9))
    async with recording() as one:
        works = one.transactions.load

        def load(surface: str, boot_id: str) -> object:
            asked.append(surface)
            if surface == "press-7":
                raise error
            return works(surface, boot_id)

        monkeypatch.setattr(one.transactions, "load", load)
        for _ in range(5):
            assert await one.take(surface_of(), batch_of(*REST), {}) == (None, None)
        assert asked == ["press-7"]
        # What another surface needs is not held up by it.
        assert await take(one, surface_of("press-8"), *REST) == (0, 4)
        now.s += 1.0
        assert await one.take(surface_of(), batch_of(*REST), {}) == (None, None)
        assert asked == ["press-7", "press-8", "press-7"]


@pytest.mark.parametrize(("error", "reason"), ERRORS)
async def test_a_commit_that_fails_makes_the_record_away_until_one_succeeds(
    monkeypatch: pytest.MonkeyPatch, error: Exception, reason: str
) -> None:
    surface = surface_of()
    async with recording() as one:
        assert await take(one, surface, RESTING, TOUCHING, RESTING) == (0, 4)
        mend = breaking(monkeypatch, one, "commit", error)
        await commit(one)
        await asyncio.sleep(0)
        assert (one.away_because, one.outages, one.waiting) == (reason, 1, {"press-7": 3})
        mend()
        await asyncio.wait([one.commit()])  # what failed is due at once
        assert (one.away_because, one.outages, one.waiting) == ("", 1, {"press-7": 0})
        found, _ = await one.write(lambda transactions: transactions.due("line-3", 9, from_start=True))
        assert [event.event.end for event in found] == ["lift"]


async def test_a_health_that_cannot_be_read_is_read_later(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = surface_of()
    async with recording() as one:
        one.watch(surface)
        mend = breaking(monkeypatch, one, "healths", RecordAwayError("no route"))
        await commit(one)
        assert (one.away_because, surface.health) == ("no route", None)
        mend()
        await commit(one)
        assert one.away_because == ""
        assert surface.health is not None


async def test_a_damaged_health_is_none_of_an_outage_and_costs_no_other_surface_its_health(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    events = EventsSection(file=tmp_path / "events.db")
    surfaces = [surface_of("press-7"), surface_of("press-8")]
    async with recording(events):
        pass
    model = surfaces[0].model
    assert model is not None
    for surface in surfaces:
        execute(tmp_path / "events.db", "INSERT INTO health VALUES (?, 1, ?, NULL, 5)", surface.name, model.identity)
    execute(tmp_path / "events.db", "INSERT INTO health_blocks VALUES ('press-7', 1, 0, '[1,2')")
    async with recording(events) as one:
        for surface in surfaces:
            one.watch(surface)
        for _ in range(3):
            await commit(one)
            assert (one.away_because, one.outages) == ("", 0)
        assert None not in [surface.health for surface in surfaces]
        for surface in surfaces:
            assert await take(one, surface, *REST) == (0, 4)
    (said,) = [text for text in caplog.messages if "health" in text]
    assert said.startswith("surface press-7: its health starts over: block 0 of 1 of the health of surface press-7 ")


async def test_a_record_that_is_away_is_asked_again_after_a_while_and_a_stop_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(recorder, "time", SimpleNamespace(monotonic=lambda: now.s, time=lambda: 1.8e9))
    folder, surface = tmp_path / "later", surface_of()
    async with recording(EventsSection(file=folder / "events.db")) as one:
        assert "unable to open database file" in one.away_because
        assert await one.take(surface, batch_of(*REST), {}) == (None, None)
        folder.mkdir()
        now.s += 0.999
        assert await one.take(surface, batch_of(*REST), {}) == (None, None)
        now.s += 0.001
        assert await take(one, surface, *REST) == (0, 4)
        assert one.away_because != ""  # nothing was written yet
        await commit(one)
        assert (one.away_because, one.outages) == ("", 1)
    assert "is away at the stop" not in caplog.text
    async with recording(EventsSection(file=tmp_path / "nowhere" / "events.db")):
        pass
    assert "the record of events is away at the stop: events file" in caplog.text
    assert caplog.messages[-1].endswith("; daemons keep their samples")


@pytest.mark.parametrize(("late_s", "reason"), [(15.0, ""), (15.01, "the database has not answered for 15 s")])
async def test_a_database_that_does_not_answer_is_away(
    monkeypatch: pytest.MonkeyPatch, late_s: float, reason: str
) -> None:
    now, go_on = SimpleNamespace(s=100.0), threading.Event()
    monkeypatch.setattr(recorder, "time", SimpleNamespace(monotonic=lambda: now.s, time=lambda: 1.8e9))
    async with recording() as one:
        await take(one, surface_of(), RESTING)
        held = asyncio.ensure_future(one.write(lambda _: go_on.wait(PATIENT_S)))
        await asyncio.sleep(0)
        written = one.commit()
        now.s += late_s
        assert one.away_because == reason
        go_on.set()
        await asyncio.wait([held, written])
        now.s += 60.0
        assert one.away_because == ""  # it has answered


async def test_a_call_of_the_record_is_given_up_after_15_s(monkeypatch: pytest.MonkeyPatch) -> None:
    assert recorder.AWAY_S == 15.0
    monkeypatch.setattr(recorder, "AWAY_S", 0.05)
    go_on = threading.Event()
    async with recording() as one:
        with pytest.raises(RecordAwayError, match=r"^it has not answered for 0\.05 s$"):
            await one.write(lambda _: go_on.wait(PATIENT_S))
        go_on.set()


async def test_a_batch_waits_for_the_record_of_its_boot_for_a_moment_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "LOAD_S", 0.05)
    go_on, surface = threading.Event(), surface_of()
    async with recording() as one:
        held = asyncio.ensure_future(one.write(lambda _: go_on.wait(PATIENT_S)))
        await asyncio.sleep(0)
        for _ in range(2):
            assert await one.take(surface, batch_of(*REST), {}) == (None, None)
        go_on.set()
        await held
        async with asyncio.timeout(PATIENT_S):
            while (receipt := await one.take(surface, batch_of(*REST), {})) == (None, None):  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        assert receipt == (0, 4)


@pytest.mark.parametrize(("error", "reason"), ERRORS)
async def test_limits_that_cannot_be_looked_after_make_the_record_away(
    monkeypatch: pytest.MonkeyPatch, error: Exception, reason: str
) -> None:
    def fail(*_: object) -> None:
        raise error

    async with recording() as one:
        monkeypatch.setattr(one.retention, "tidy", fail)
        one._begin_upkeep()
        assert one._upkeep is not None
        await asyncio.wait([one._upkeep])
        await asyncio.sleep(0)
        assert one.away_because == reason


async def test_a_stop_waits_for_a_record_that_hangs_for_2_s(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert recorder.STOP_S == 2.0
    monkeypatch.setattr(recorder, "STOP_S", 0.05)
    go_on = threading.Event()
    async with recording() as one:
        await take(one, surface_of(), RESTING)
        held = asyncio.ensure_future(one.write(lambda _: go_on.wait(PATIENT_S)))
        await asyncio.sleep(0)
    go_on.set()
    await held
    said = "the record of events is away at the stop: it has not answered for 0.05 s; daemons keep their samples"
    assert caplog.messages == [said]
