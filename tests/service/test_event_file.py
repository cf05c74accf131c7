"""The file of events, deleted or replaced under a service that runs."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from beamtouch_models import modelfile
from beamtouch_service.events import file as event_file
from beamtouch_service.events.file import EventFile
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.events.store import Selection
from beamtouch_service.surfaces.surface import Surface
from service.test_event_store import DAY_S, piece

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from beamtouch_service.samples import Batch
    from service.conftest import BuildModel


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "folder").mkdir()
    return tmp_path / "folder" / "events.db"


@pytest.fixture
def file(path: Path) -> EventFile:
    file = EventFile(path, 30 * DAY_S, 10_000_000, now_s=0.0)
    for number, now_s in ((10, 100.0), (20, 160.0)):
        file.store.write("press-7", [piece(number, number + 1)], now_s)
        assert file.look_after(now_s + 20) == 0
    file.store.write("press-7", [piece(30, 31)], 190.0)
    return file


def on_disk(path: Path) -> list[int]:
    """First sample of each event, as another process sees them."""
    with closing(sqlite3.connect(path)) as database:
        return [row[0] for row in database.execute("SELECT first_sequence FROM events ORDER BY 1")]


def known(file: EventFile) -> list[int]:
    return sorted(event.first_sequence for _, event in file.store.read(Selection()))


@pytest.mark.parametrize("endings", [[""], ["", "-wal", "-shm"]])
def test_a_deleted_file_is_opened_anew_with_what_came_since_it_was_seen_last(
    file: EventFile, path: Path, caplog: pytest.LogCaptureFixture, endings: list[str]
) -> None:
    for ending in endings:
        path.with_name(path.name + ending).unlink()
    file.store.write("press-7", [piece(40, 41)], 200.0)
    assert file.look_after(240.0) == 0

    assert on_disk(path) == known(file) == [30, 40]
    # The last one still goes on.
    file.store.write("press-7", [piece(42, 43), piece(50, 51)], 250.0)
    assert file.look_after(300.0) == 0
    assert file.close(301.0) == 0
    assert on_disk(path) == [30, 40, 50]
    (record,) = caplog.records
    assert f"{path} was deleted or replaced while it was open" in record.getMessage()


def test_a_file_in_the_place_of_the_open_one_is_used_and_completed(file: EventFile, path: Path) -> None:
    backup = path.with_name("backup.db")
    with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(backup)) as target:
        source.backup(target)
    file.store.write("press-7", [piece(40, 41)], 200.0)
    backup.replace(path)
    assert file.look_after(240.0) == 0

    assert on_disk(path) == known(file) == [10, 20, 30, 40]
    assert file.close(241.0) == 0
    assert on_disk(path) == [10, 20, 30, 40]


def test_without_a_place_for_it_events_wait_in_memory(
    file: EventFile, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shutil.rmtree(path.parent)
    assert file.look_after(240.0) == 0
    file.store.write("press-7", [piece(40, 41)], 250.0)
    assert file.look_after(300.0) == 0
    assert known(file) == [30, 40]
    path.parent.mkdir()
    file.store.write("press-7", [piece(50, 51)], 310.0)
    assert file.look_after(360.0) == 0

    assert on_disk(path) == known(file) == [30, 40, 50]
    assert [record.levelname for record in caplog.records] == ["ERROR", "WARNING"]
    assert "kept in memory only" in caplog.records[0].getMessage()
    file.close(361.0)


def test_what_cannot_be_kept_is_counted(file: EventFile, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_file, "_MOST_CARRIED", 2)
    for number in (40, 50, 60):
        file.store.write("press-7", [piece(number, number + 1)], 200.0 + number)
    path.unlink()
    assert file.look_after(300.0) == 2
    assert on_disk(path) == known(file) == [50, 60]

    shutil.rmtree(path.parent)
    assert file.close(360.0) == 2


def test_a_recorder_whose_file_is_deleted_has_one_again(
    path: Path, build_model: BuildModel, parse_batch: Callable[..., Batch]
) -> None:
    recorder, surface = Recorder(path), Surface("press-7", modelfile.load(build_model()))
    surface.witness = recorder
    surface.receive(parse_batch([0.5, 0.25, 0.125], [0.0, 0.0, 0.0]), arrival_s=10.0)
    recorder.ask(lambda _: path.unlink()).result(60)
    surface.receive(parse_batch([0.5, 0.25, 0.125], sequence=3), arrival_s=10.1)
    recorder.ask(lambda _: recorder.look_after()).result(60)
    # The first was seen in its place, and went with it.
    assert on_disk(path) == [3]

    surface.receive(parse_batch([0.5, 0.25, 0.125], [0.0, 0.0, 0.0], sequence=4), arrival_s=10.2)
    recorder.close()
    assert (on_disk(path), recorder.lost) == ([3], 0)
    with closing(sqlite3.connect(path)) as database:
        assert database.execute('SELECT samples, "end" FROM events').fetchall() == [(2, "lift")]
