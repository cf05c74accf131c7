"""The file of the logs: over restarts, bounded, damaged, of another program, in use by another daemon, or gone."""

import asyncio
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from beamtouch_daemon.delivery import log_store
from beamtouch_daemon.delivery.log_file import ForeignFileError, LogFile, LogFileError
from beamtouch_service.record.events.surface_record import LATE_S
from beamtouch_service.record.recorder import COMMIT_S
from beamtouch_service.samples import Batch, Note, Sample

from .publishing import ROOM, Bench, boot, hang, keep, put_chunks, stored, taken, taken_of
from .service import Service, serving
from .waits import until

pytestmark = pytest.mark.anyio


async def recorded(path: Path) -> Service:
    """Deliver a file to a service; return that."""
    async with (
        stored(path) as store,
        serving(Service()) as service,
        Bench(service, store, head=boot("boot-last")) as bench,
    ):
        await until(lambda: not bench.logs.on_disk)
    return service


async def test_samples_of_earlier_boots_are_read_out_in_order_with_the_facts_they_were_taken_with(
    tmp_path: Path,
) -> None:
    head = Batch(
        boot_id="boot-0000",
        channels=["a", "b"],
        samples=[],
        noise_mm=[0.2, 0.1],
        characteristic="4f2c91d0aa17",
        beam="beam-1",
    )
    stated = [
        taken_of(
            Sample.model_validate(
                {"sequence": number, "acquired_unix_us": 5, "deflection_mm": [0.1 * number, None]}
                | {"quality": ["good", "missing"], "readings": 4, "covariance_mm2": [0.01, 0.0, 0.0]}
            ),
            notes=(Note.RATE,) if number > 4 else (),
        )
        for number in range(1, 8)
    ]
    async with stored(tmp_path / "samples") as store:
        store.surface("bench").begin(head, 100).log.put(stated)
        store.surface("other").begin(boot(), 100).log.put(taken(1, 3))
    await keep(tmp_path / "samples", 5, 6, boot_id="boot-000b")
    service = await recorded(tmp_path / "samples")
    assert service.record.numbers() == {"boot-0000": list(range(1, 8)), "boot-000b": list(range(1, 12))}
    assert service.record.numbers("other") == {}  # of this surface, nobody reads
    batches = [batch for _, batch, _ in service.batches if batch.boot_id == "boot-0000" and batch.samples]
    assert [(len(batch.samples), batch.notes) for batch in batches] == [(4, []), (3, ["rate"])]
    for batch in batches:
        assert (batch.channels, batch.noise_mm, batch.characteristic, batch.beam) == (
            ["a", "b"],
            [0.2, 0.1],
            "4f2c91d0aa17",
            "beam-1",
        )
    assert [sample for batch in batches for sample in batch.samples] == [one.sample for one in stated]
    assert (await recorded(tmp_path / "samples")).record.numbers() == {}


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "Limit of the size of that file; beyond it the oldest samples are dropped and counted.",
)
async def test_beyond_its_size_the_oldest_are_dropped_and_counted_and_lost_to_the_record(tmp_path: Path) -> None:
    async with stored(tmp_path / "tiny", 50) as store:
        await put_chunks(store, boot(), *[10] * 2)
        assert (store.surface("bench").counts.dropped, store.surface("bench").on_disk) == (20, 0)
    async with stored(tmp_path / "samples", 20_000) as store:
        await put_chunks(store, boot(), *[10] * 40)
        counts = store.surface("bench").counts
        assert 0 < store.surface("bench").on_disk == 400 - counts.dropped < 400
    assert (tmp_path / "samples").stat().st_size < 70_000
    service = await recorded(tmp_path / "samples")
    first = counts.dropped + 1
    assert service.record.numbers() == {"boot-0001": list(range(first, 401))}
    assert service.record.lost["bench", "boot-0001"] == list(range(1, first))


async def test_a_chunk_that_is_dropped_while_it_is_about_to_be_read_is_a_loss_and_no_error(tmp_path: Path) -> None:
    await keep(tmp_path / "samples", 10, 10)
    go_on = threading.Event()
    async with stored(tmp_path / "samples", 2000) as store, serving(Service()) as service:
        disk = asyncio.ensure_future(hang(store, go_on))
        async with Bench(service, store) as bench:
            bench.count(5)
            writes = asyncio.ensure_future(store.write(None))
            await until(lambda: any(batch.boot_id == "boot-0000" for _, batch, _ in service.batches))
            await asyncio.sleep(0.2)  # the reader waits for the disk, behind the writer
            go_on.set()
            await asyncio.gather(disk, writes)
            await until(lambda: bench.log.is_empty and not bench.logs.on_disk)
    assert service.record.lost["bench", "boot-0000"] == list(range(1, 11))
    assert service.record.numbers() == {"boot-0000": list(range(11, 21)), "boot-0001": list(range(1, 6))}


@contextmanager
def opened(path: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(path)) as database, database:
        yield database


def head(path: Path) -> None:
    path.write_bytes(b"this is no database, however long it may be" * 100)


def changed(columns: str) -> Callable[[Path], None]:
    """Return what changes columns of the second row."""

    def change(path: Path) -> None:
        with opened(path) as database:
            database.execute(f"UPDATE chunk SET {columns} WHERE id = 2")  # noqa: S608 - of this file

    return change


one_bit = changed("content = CAST(replace(content, '[0.1,', '[0.5,') AS BLOB)")
another_number = changed("first = first - 1, last = last - 1")
text = changed("first = 'ten'")
another_surface = changed("surface = 'press-8'")


def pages(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[4096:12288] = b"\x55" * 8192
    path.write_bytes(content)


def alone(path: Path) -> None:
    """Zeros in the place of its head, and no journal, as of a log that was copied without it."""
    content = bytearray(path.read_bytes())
    content[:4096] = bytes(4096)
    path.write_bytes(content)
    path.with_name(f"{path.name}-journal").unlink()


def damaged(path: Path) -> list[Path]:
    """Return the files that were set aside, without their journals."""
    return [one for one in path.parent.glob(f"{path.name}.damaged*") if not one.name.endswith("-journal")]


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "A damaged log file is renamed to `FILE.damaged` and a new one begun",
)
@pytest.mark.parametrize(
    "damage",
    [head, one_bit, another_number, another_surface, text, pages, alone],
    ids=["head", "bit", "number", "surface", "text", "pages", "head, without the journal"],
)
async def test_a_damaged_file_is_set_aside_whole_and_a_new_one_begins(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: Callable[[Path], None]
) -> None:
    path = tmp_path / "samples"
    await keep(path, *[100] * 5)
    damage(path)
    async with serving(Service()) as service:
        async with stored(path) as store, Bench(service, store) as bench:
            bench.count(10)
            await until(lambda: bench.log.is_empty and not bench.logs.on_disk)
            service.problem_of = lambda *_: (503, "busy")
            bench.count(10)
        # What is damaged never arrives, and what comes after it is kept as before.
        assert service.record.numbers()["boot-0001"] == list(range(1, 11))
        found = service.record.numbers().get("boot-0000", [])
        assert found == list(range(1, len(found) + 1))
    assert (await recorded(path)).record.numbers() == {"boot-0001": list(range(11, 21))}
    (aside,) = damaged(path)
    (said,) = [text for text in caplog.messages if "damaged" in text and "recover" in text]
    assert f"`sqlite3 {aside} .recover` shows what is left in it" in said


async def test_damaged_files_do_not_pile_up_and_the_newest_stays(tmp_path: Path) -> None:
    await keep(tmp_path / "samples", 1)
    for turn in range(6):
        (tmp_path / "samples").write_bytes(b"this is no database" * 100 + bytes([turn]))
        async with stored(tmp_path / "samples"):
            pass
    (aside,) = damaged(tmp_path / "samples")
    assert aside.read_bytes()[-1] == 5


def delete(path: Path) -> None:
    for tail in ("", "-journal"):
        path.with_name(path.name + tail).unlink()


@pytest.mark.parametrize("replaced", [False, True])
async def test_a_file_that_is_deleted_or_replaced_in_use_is_begun_anew_and_the_loss_is_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, *, replaced: bool
) -> None:
    path = tmp_path / "samples"
    await keep(path, 30)
    async with stored(path) as store, serving(Service()) as service, Bench(service, store) as bench:
        delete(path)
        if replaced:
            await keep(path, 7, boot_id="boot-000c")
        bench.count(5)
        await until(lambda: bench.log.is_empty)
        await until(lambda: bench.logs.counts.dropped == 30)
        if replaced:
            await until(lambda: len(service.record.numbers().get("boot-000c", [])) == 7)
            await until(lambda: not bench.logs.on_disk)
        service.problem_of = lambda *_: (503, "busy")
        bench.count(5)
    assert sum("was deleted or replaced while in use" in text for text in caplog.messages) == 1
    assert (await recorded(path)).record.numbers() == {"boot-0001": list(range(6, 11))}


def batch_of(first: int, number: int, boot_id: str = "boot-0001") -> Batch:
    samples = [one.sample for one in taken(first, number)]
    return boot(boot_id).model_copy(update={"samples": samples, "backlog": True})


@contextmanager
def log_file(path: Path, max_bytes: int = ROOM) -> Iterator[LogFile]:
    file = LogFile(path, max_bytes)
    file.open()
    try:
        yield file
    finally:
        file.close()


async def test_a_file_holds_as_many_bytes_as_its_limit_and_of_more_the_newest_chunks(tmp_path: Path) -> None:
    with log_file(tmp_path / "all") as file:
        rows = file.change([("bench", batch_of(1, 3)), ("other", batch_of(4, 3))], set())
        assert list(file.rows) == rows == [1, 2]
        both = sum(file.rows.values())
    for max_bytes, kept in ((both, rows), (both - 1, rows[1:]), (10, [])):
        with log_file(tmp_path / f"at most {max_bytes}", max_bytes) as file:
            assert file.change([("bench", batch_of(1, 3)), ("other", batch_of(4, 3))], set()) == rows
            assert list(file.rows) == kept
            assert [file.read(row) is not None for row in rows] == [row in kept for row in rows]
        with log_file(tmp_path / f"at most {max_bytes}") as file:
            assert list(file.rows) == kept


async def test_a_change_keeps_the_rows_that_are_named_and_adds_others(tmp_path: Path) -> None:
    with log_file(tmp_path / "samples") as file:
        file.change([("bench", batch_of(number, 1)) for number in (1, 2, 3)], set())
        assert file.change([("bench", batch_of(4, 1))], {1, 3}) == [4]
        assert file.read(2) is None
        assert file.read(3) == batch_of(3, 1)
        assert file.change([], {3}) == []
        assert list(file.rows) == [3]
    with log_file(tmp_path / "samples") as file:
        assert file.change([("bench", batch_of(5, 1))], {3}) == [5]  # no number is used twice


async def test_a_file_is_read_with_the_surface_and_the_first_chunk_of_each_boot(tmp_path: Path) -> None:
    chunks = [
        ("bench", batch_of(1, 2)),
        ("bench", batch_of(3, 2)),
        ("other", batch_of(1, 2)),
        ("bench", batch_of(1, 2, "boot-0002")),
    ]
    with log_file(tmp_path / "samples") as file:
        file.change(chunks, set())
    file = LogFile(tmp_path / "samples", ROOM)
    assert not file.is_open
    found = file.open()
    assert file.is_open
    assert [(surface, chunk, example.boot_id, example.samples[0].sequence) for surface, chunk, example in found] == [
        ("bench", (1, 1, 2), "boot-0001", 1),
        ("bench", (2, 3, 4), "boot-0001", 1),
        ("other", (3, 1, 2), "boot-0001", 1),
        ("bench", (4, 1, 2), "boot-0002", 1),
    ]
    file.close()
    assert not file.is_open
    with pytest.raises(LogFileError, match="is not open"):
        file.read(1)


async def test_the_journal_has_room_for_deletions_on_a_full_disk_and_does_not_grow_at_each_start(
    tmp_path: Path,
) -> None:
    for _ in range(3):
        with log_file(tmp_path / "samples") as file:
            file.change([("bench", batch_of(1, 1))], set())
            assert (tmp_path / "samples-journal").stat().st_size == 65_536
    # One that became longer stays so.
    (tmp_path / "samples-journal").write_bytes(bytes(70_000))
    with log_file(tmp_path / "samples") as file:
        assert len(file.rows) == 1


@pytest.mark.parametrize("content", [b"a text\n", b"SQLite format 4\0" * 300])
async def test_a_file_that_never_was_a_log_is_refused_and_keeps_its_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "samples"
    path.write_bytes(content)
    with pytest.raises(ForeignFileError, match="samples is not a log; choose another file"):
        LogFile(path, ROOM).open()
    assert (path.read_bytes(), path.with_name("samples.damaged").exists()) == (content, False)


@pytest.mark.parametrize(
    ("content", "has_journal"),
    [(b"a text\n" * 300, True), (b"SQLite format 3\0" + bytes(2000), False), (bytes(4096), False)],
)
async def test_a_file_that_was_a_log_is_damaged(tmp_path: Path, content: bytes, has_journal: bool) -> None:
    path = tmp_path / "samples"
    path.write_bytes(content)
    if has_journal:
        path.with_name("samples-journal").touch()
    with pytest.raises(
        LogFileError, match=r"^the file is damaged \(.*\); `sqlite3 .*/samples\.damaged \.recover` shows"
    ):
        LogFile(path, ROOM).open()
    assert path.with_name("samples.damaged").read_bytes() == content


async def test_a_file_that_was_cut_off_to_nothing_begins_anew(tmp_path: Path) -> None:
    (tmp_path / "samples").touch()
    with log_file(tmp_path / "samples") as file:
        assert file.change([("bench", batch_of(1, 1))], set()) == [1]


async def test_the_database_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "samples"
    with opened(path) as database:
        database.execute("CREATE TABLE people (name TEXT)")
    with pytest.raises(ForeignFileError, match="is the database of another program or of another version"):
        LogFile(path, ROOM).open()
    # An empty one is taken.
    empty = tmp_path / "empty"
    with opened(empty) as database:
        database.execute("PRAGMA user_version = 7")
    with log_file(empty) as file:
        assert file.rows == {}


async def test_a_file_in_use_says_so(tmp_path: Path) -> None:
    with log_file(tmp_path / "samples"):
        pass
    with log_file(tmp_path / "samples"):
        other = LogFile(tmp_path / "samples", ROOM)
        with pytest.raises(LogFileError, match=r"cannot be opened \(in use by another process\)$"):
            other.open()
        assert not other.is_open
    nowhere = tmp_path / "nowhere" / "samples"
    with pytest.raises(LogFileError, match=r"nowhere/samples cannot be opened \(unable to open database file\)$"):
        LogFile(nowhere, ROOM).open()


@pytest.mark.parametrize(
    ("code", "is_damage"),
    [
        *((sqlite3.SQLITE_CORRUPT, True), (sqlite3.SQLITE_NOTADB, True), (sqlite3.SQLITE_CORRUPT_INDEX, True)),
        *((sqlite3.SQLITE_IOERR_READ, True), (sqlite3.SQLITE_IOERR_CORRUPTFS, True)),
        *((sqlite3.SQLITE_IOERR, False), (sqlite3.SQLITE_IOERR_WRITE, False), (sqlite3.SQLITE_FULL, False)),
        *((sqlite3.SQLITE_BUSY, False), (sqlite3.SQLITE_READONLY, False), (None, False)),
    ],
)
async def test_what_sqlite_says_is_damage_or_passes(tmp_path: Path, code: int | None, is_damage: bool) -> None:
    error: Exception = OSError("no such device")
    if code is not None:
        error = sqlite3.Error("some words")
        error.sqlite_errorcode = code
    with log_file(tmp_path / "samples") as file:
        with pytest.raises(LogFileError) as caught, file._errors("read"):
            raise error
        words = "in use by another process" if code == sqlite3.SQLITE_BUSY else str(error)
        assert str(caught.value).endswith(f"cannot be read ({words})") is not is_damage
        assert str(caught.value).startswith(f"the file is damaged ({error})") is is_damage
        assert file.is_open is not is_damage
    assert (tmp_path / "samples").exists() is not is_damage


async def test_what_is_not_durable_after_5_s_goes_to_the_file_but_what_a_live_batch_brings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The record makes it durable a second earlier."""
    assert (log_store.WRITE_S, log_store.MEMORY_S) == (1.0, 5.0)
    assert LATE_S + COMMIT_S + 1.0 <= log_store.MEMORY_S
    monkeypatch.setattr(log_store, "WRITE_S", 0.01)
    async with stored(tmp_path / "samples") as store:
        held = {}
        for name, age_s, brought in (("young", 1.0, 3), ("old", 5.01, 3), ("partly", 5.01, 1)):
            one = held[name] = store.surface(name).begin(boot(), 100)
            one.put(taken(1, 3, age_s))
            one.live.begin(1, brought)
            one.live.end(1)
        writing = asyncio.ensure_future(store.run())
        await until(lambda: held["old"].log.on_disk == 3)
        writing.cancel()
        assert {name: (one.log.on_disk, one.log.in_memory) for name, one in held.items()} == {
            "young": (0, 3),
            "old": (3, 0),
            "partly": (1, 2),
        }
        await store.write(None)
        assert [one.log.in_memory for one in held.values()] == [0, 0, 0]


async def test_a_store_that_is_closed_leaves_no_thread_that_waits_for_the_disk(tmp_path: Path) -> None:
    before = set(threading.enumerate())
    async with stored(tmp_path / "samples") as store:
        (its_own,) = set(threading.enumerate()) - before
    assert not its_own.is_alive()
    assert store.surfaces() == {}
