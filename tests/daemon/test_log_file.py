"""The file of the logs: over restarts, bounded, damaged, of another program, in use by another daemon, or gone."""

import asyncio
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from beamtouch_service.samples import Batch, Note, Sample

from .publishing import Bench, boot, hang, keep, put_chunks, stored, taken, taken_of
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
    [head, one_bit, another_number, text, pages, alone],
    ids=["head", "bit", "number", "text", "pages", "head, without the journal"],
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
