"""The recorder: which samples of a batch it takes, what its receipts say, and what it commits."""

import asyncio
import threading
from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from sqlalchemy import literal, select

from beamtouch_service.record import recorder
from beamtouch_service.record.database.connections import Database
from beamtouch_service.record.events import boot_record
from beamtouch_service.record.writing.retention import Deleted
from beamtouch_service.record.writing.transactions import Due, Transactions
from beamtouch_service.sections import EventsSection
from beamtouch_service.surfaces.channels import SurfaceHealth
from beamtouch_service.surfaces.estimate import Estimate, Estimator
from service.bench import surface_of, surface_with
from service.event_story import RESTING, TOUCHING
from service.recorder_bench import PATIENT_S, REST, batch_of, commit, recording, take
from support.surfaces.small_model import model_of

pytestmark = pytest.mark.anyio


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


def finished(transactions: Transactions, limit: int = 9) -> tuple[list[Due], int]:
    return transactions.due("line-3", limit, from_start=False)


async def test_who_waits_for_events_is_told_by_the_commit_that_ends_one() -> None:
    surface = surface_of()
    async with recording() as one:
        calls = list[int]()

        def asked(transactions: Transactions) -> tuple[list[Due], int]:
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


async def test_behind_damaged_events_the_first_whole_one_is_found_and_others_have_a_turn_before() -> None:
    async with recording() as one:
        await one.write(finished)
        await take(one, surface_of(), *[RESTING, TOUCHING] * 6, RESTING)
        await commit(one)
        await one.write(damage_five)
        calls, counts = list[int](), list[asyncio.Task[int]]()
        loop = asyncio.get_running_loop()

        def asked(transactions: Transactions) -> tuple[list[Due], int]:
            calls.append(1)
            if len(calls) == 1:  # what is asked of the record meanwhile
                loop.call_soon_threadsafe(lambda: counts.append(loop.create_task(one.write(lambda _: len(calls)))))
            return finished(transactions, limit=2)

        async with asyncio.timeout(PATIENT_S):
            (due,) = await one.wait_for_finished(asked)
            assert (due.number, len(calls), await counts[0]) == (6, 3, 1)


def damage_five(transactions: Transactions) -> None:
    with transactions.database.writing() as connection:
        connection.exec_driver_sql("UPDATE events SET samples = -1 WHERE id < 6")


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


async def test_the_health_on_record_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, healths = list[int](), Transactions.healths

    def count(transactions: Transactions) -> object:
        asked.append(len(asked))
        return healths(transactions)

    monkeypatch.setattr(Transactions, "healths", count)
    surface = surface_of()
    async with recording() as one:
        one.watch(surface)
        for _ in range(3):
            await commit(one)
        assert surface.health is not None
    assert asked == [0]
