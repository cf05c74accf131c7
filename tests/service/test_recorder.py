"""The recorder: which samples of a batch it takes, what its receipts say, and when it counts as away."""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Collection, Iterable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from sqlalchemy import literal, select

from beamtouch_service.record import recorder
from beamtouch_service.record.database.connections import Database
from beamtouch_service.record.database.errors import RecordAwayError, UnreadableRowError
from beamtouch_service.record.events import boot_record
from beamtouch_service.record.recorder import Recorder
from beamtouch_service.record.writing.retention import Deleted
from beamtouch_service.record.writing.transactions import Due, Transactions
from beamtouch_service.samples import Batch
from beamtouch_service.sections import EventsSection
from beamtouch_service.surfaces.channels import SurfaceHealth
from beamtouch_service.surfaces.estimate import Estimate, Estimator
from beamtouch_service.surfaces.surface import Surface
from service.bench import Row, parsed, surface_of, surface_with
from service.event_story import RESTING, TOUCHING
from service.record_file import execute
from support.surfaces.small_model import model_of

pytestmark = pytest.mark.anyio

PATIENT_S = 30.0
REST: list[Row] = [RESTING] * 3


def batch_of(*rows: Row, first: int = 1, oldest: int | None = 1, boot_id: str = "boot-0001") -> Batch:
    """Return samples from this number on; without rows, a batch that only asks."""
    batch = parsed(*rows, sequence=first, boot_id=boot_id)
    return batch.model_copy(update={"oldest": oldest} | ({} if rows else {"samples": []}))


@asynccontextmanager
async def recording(events: EventsSection | None = None) -> AsyncIterator[Recorder]:
    one = Recorder(events or EventsSection())
    try:
        yield one
    finally:
        await one.close()


async def take(one: Recorder, surface: Surface, *rows: Row, first: int = 1, oldest: int | None = 1) -> tuple[int, int]:
    """Let samples be taken that have a record; return its receipt."""
    durable, expected = await one.take(surface, batch_of(*rows, first=first, oldest=oldest), {})
    assert durable is not None
    assert expected is not None
    return durable, expected


async def commit(one: Recorder) -> None:
    await asyncio.wait([one.commit(everything=True)])


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


async def test_without_a_model_all_is_durable_and_with_one_that_is_refused_nothing() -> None:
    surface = surface_with(None)
    async with recording() as one:
        assert await take(one, surface, *REST, first=4) == (6, 7)
        assert await take(one, surface, oldest=9) == (8, 9)
        assert await take(one, surface, oldest=None) == (0, 1)
        surface.model_error = "damaged"
        assert await one.take(surface, batch_of(*REST), {}) == (None, None)
        assert one.waiting == one.lost == {}


async def test_samples_are_taken_from_the_expected_one_on() -> None:
    surface = surface_of()
    async with recording() as one:
        assert await take(one, surface, *REST) == (0, 4)
        assert await take(one, surface, *REST, first=5) == (0, 4)  # one is missing
        assert await take(one, surface, *REST, first=3) == (0, 6)  # one was there
        assert await take(one, surface, *REST, first=6) == (0, 9)
        assert (one.waiting, one.lost) == ({"press-7": 8}, {"press-7": 0})
        await commit(one)
        assert await take(one, surface) == (8, 9)
        # What its sender no longer has is lost, and of one that keeps nothing what is between.
        assert await take(one, surface, *REST, first=11, oldest=None) == (8, 14)
        assert (one.waiting, one.lost) == ({"press-7": 5}, {"press-7": 2})
        assert await take(one, surface, oldest=17) == (8, 17)
        assert one.lost == {"press-7": 5}


async def test_samples_for_which_there_is_no_room_are_left_to_the_sender(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(boot_record, "MAX_WAITING", 4)
    surface = surface_of()
    async with recording() as one:
        assert await take(one, surface, *REST, *REST) == (0, 5)
        await commit(one)
        assert await take(one, surface, *REST, first=5) == (4, 8)


@pytest.mark.parametrize("change", ["model", "race", "room"])
async def test_what_changes_between_two_samples_ends_the_taking(monkeypatch: pytest.MonkeyPatch, change: str) -> None:
    surface = surface_of()
    async with recording() as one:
        assert await take(one, surface, RESTING) == (0, 2)
        record = one._records["press-7"]
        held = record.boot("boot-0001")
        assert held is not None
        steps = one._add(record, batch_of(*REST, first=2), {})
        next(steps)
        if change == "model":
            surface.adopt(model_of("other"))
        elif change == "race":
            del one._records["press-7"]
        else:
            monkeypatch.setattr(boot_record, "MAX_WAITING", 1)
        assert list(steps) == []
        assert held.expected == 3


@pytest.mark.parametrize("forgotten", ["surface", "boot"])
async def test_what_is_forgotten_while_a_batch_is_taken_is_not_known_to_its_receipt(
    monkeypatch: pytest.MonkeyPatch, forgotten: str
) -> None:
    """Another service has it, or nobody needs the boot."""
    surface = surface_of()
    async with recording() as one:
        assert await take(one, surface, RESTING) == (0, 2)

        async def finish(steps: Iterable[object]) -> None:
            assert list(steps)
            if forgotten == "surface":
                del one._records["press-7"]
            else:
                one._records["press-7"]._boots.clear()

        monkeypatch.setattr(one._stepper, "finish", finish)
        assert await one.take(surface, batch_of(*REST, first=2), {}) == (None, None)


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


async def test_samples_that_moved_the_answer_are_not_weighed_again_if_all_of_them_did() -> None:
    surface, model = surface_of(), model_of()
    moved = batch_of(*[TOUCHING] * 3)
    weighed = {one.sample.sequence: one for one in Estimator(model, "press-7").estimate(moved, moved.samples)}

    async def begins(known: dict[int, Estimate]) -> str:
        async with recording() as one:
            await one.take(surface, batch_of(*REST), known)
            await commit(one)
            events = await one.write(lambda transactions: transactions.due("line-3", 9, from_start=True)[0])
            assert events == []  # an open event is none
            held = one._records["press-7"].boot("boot-0001")
            assert held is not None
            return "contact" if held.event else "clear"

    assert await begins(weighed) == "contact"
    assert await begins({2: weighed[2]}) == "clear"
    assert await begins({}) == "clear"


async def test_a_model_that_comes_while_the_record_is_read_gets_the_samples_again() -> None:
    surface = surface_of()
    async with recording() as one:
        taking = asyncio.ensure_future(one.take(surface, batch_of(*REST), {}))
        await asyncio.sleep(0)
        surface.adopt(model_of("other"))
        assert await taking == (None, None)
        assert await take(one, surface, *REST) == (0, 4)
        surface.adopt(model_of())
        assert await take(one, surface, *REST, first=4) == (0, 7)


async def test_what_is_due_is_made_durable_and_what_is_not_waits() -> None:
    surface = surface_of()
    async with recording() as one:
        await take(one, surface, RESTING)
        await asyncio.wait([one.commit()])  # the first samples of a boot
        await take(one, surface, RESTING, first=2)
        await asyncio.wait([one.commit()])
        assert (await one.take(surface, batch_of(RESTING, first=3), {}))[0] == 1
        await one.flush()
        assert (await take(one, surface))[0] == 3
        assert one.races == 0


async def test_a_commit_that_runs_is_the_one_that_is_returned() -> None:
    async with recording() as one:
        await take(one, surface_of(), RESTING)
        first = one.commit()
        assert one.commit() is first
        await asyncio.wait([first])
        assert one.commit() is not first


def finished(transactions: Transactions) -> list[Due]:
    return transactions.due("line-3", 9, from_start=False)[0]


async def test_who_waits_for_events_is_told_by_the_commit_that_ends_one() -> None:
    surface = surface_of()
    async with recording() as one:
        calls = list[int]()

        def asked(transactions: Transactions) -> list[Due]:
            calls.append(1)
            return finished(transactions)

        waiting = asyncio.ensure_future(one.wait_for_finished(asked))
        await take(one, surface, RESTING, TOUCHING)
        await commit(one)
        await asyncio.sleep(0.02)
        assert not waiting.done()
        await take(one, surface, RESTING, first=3)
        await commit(one)
        async with asyncio.timeout(PATIENT_S):
            (due,) = await waiting
        assert (due.number, due.event.end, len(calls)) == (1, "lift", 2)


async def test_of_two_services_the_one_that_lost_reads_anew(tmp_path: Path) -> None:
    events, surface = EventsSection(file=tmp_path / "events.db"), surface_of()
    async with recording(events) as one, recording(events) as other:
        for each in (one, other):
            await take(each, surface, *REST)
        await commit(one)
        await commit(other)
        assert (one.races, other.races, one.lost, other.lost) == (0, 1, {"press-7": 0}, {})
        assert await take(other, surface) == (3, 4)
        assert (one.outages, other.outages, other.away_because) == (0, 0, "")


async def test_a_stop_makes_durable_what_was_taken(tmp_path: Path) -> None:
    events, surface = EventsSection(file=tmp_path / "events.db"), surface_of()
    async with recording(events) as one:
        await take(one, surface, RESTING)
        await commit(one)
        await take(one, surface, *REST, first=2)  # nobody waits for these
    async with recording(events) as one:
        assert await take(one, surface) == (4, 5)


async def test_a_stop_leaves_neither_threads_nor_open_files(tmp_path: Path) -> None:
    path, before = tmp_path / "events.db", set(threading.enumerate())
    async with recording(EventsSection(file=path)) as one:
        await take(one, surface_of(), RESTING)
        await commit(one)
        assert await one.readers.read(lambda reader: reader.rows(select(literal(1)))) == [(1,)]
        assert open_files(path)
    async with asyncio.timeout(PATIENT_S):
        while set(threading.enumerate()) - before or open_files(path):  # noqa: ASYNC110 - of other threads
            await asyncio.sleep(0.01)


def open_files(path: Path) -> list[str]:
    """Return the files of a record that this process has open."""
    found = list[str]()
    for link in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # it is closed meanwhile
            found.append(str(link.readlink()))
    return [name for name in found if name.startswith(str(path))]


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


async def test_the_limits_are_looked_after_at_once_and_then_each_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    """And what was taken is committed each second; here, all of it goes 100 times as fast."""
    assert (recorder.COMMIT_S, recorder.TIDY_S) == (1.0, 60.0)
    monkeypatch.setattr(recorder, "COMMIT_S", 0.01)
    now, looks_s = SimpleNamespace(s=100.0), list[float]()
    monkeypatch.setattr(recorder, "time", SimpleNamespace(monotonic=lambda: now.s, time=lambda: 1.8e9))
    async with recording() as one:
        tidy = one.retention.tidy

        def looking(
            database: Database, clock_s: float, uptime_s: float, held: Collection[tuple[str, str]] = ()
        ) -> Deleted:
            looks_s.append(now.s)
            return tidy(database, clock_s, uptime_s, held)

        monkeypatch.setattr(one.retention, "tidy", looking)
        running = asyncio.ensure_future(one.run())
        for step_s in (0.0, 59.9, 0.1, 59.9):
            now.s += step_s
            await asyncio.sleep(0.1)
            assert one._upkeep is not None
            await asyncio.wait([one._upkeep])
        running.cancel()
        assert looks_s == [100.0, 160.0]
        surface = surface_of()
        await take(one, surface, RESTING)
        running = asyncio.ensure_future(one.run())
        async with asyncio.timeout(PATIENT_S):
            while one.waiting["press-7"]:  # noqa: ASYNC110 - of another task
                await asyncio.sleep(0.01)
        running.cancel()


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


async def test_the_health_on_record_is_stated_before_samples_come(tmp_path: Path) -> None:
    events = EventsSection(file=tmp_path / "events.db")
    async with recording(events) as one:
        await take(one, surface_of(), RESTING, TOUCHING, RESTING)
        await commit(one)
    waiting, known, without = surface_of(), surface_of("press-9"), surface_of("press-8")
    async with recording(events) as one:
        known.health = SurfaceHealth("as it was", {})
        for surface in (waiting, known, without):
            one.watch(surface)
        await asyncio.wait([one.commit()])
        assert waiting.health is not None
        assert [channel.contacts for channel in waiting.health.channels.values()] == [1] * 3
        assert known.health.model == "as it was"
        assert without.health is not None
        assert without.health.channels == {}
