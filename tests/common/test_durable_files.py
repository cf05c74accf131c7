"""A file that is replaced is on the disk before it has its name: a loss of power leaves the old one or the new one."""

import errno
import os
import stat
from contextlib import nullcontext
from pathlib import Path

import pytest

from beamtouch_common.archives import Part, restore_archive, write_archive
from beamtouch_common.files import write_atomically

OLD, NEW = b"old", b"new and longer"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "bench.tare.json"
    path.write_bytes(OLD)
    return path


def test_the_content_is_on_the_disk_before_the_file_has_its_name(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[tuple[int, int, bytes]] = []
    sync = os.fsync

    def note(descriptor: int) -> None:
        sync(descriptor)
        state = os.fstat(descriptor)
        synced.append((state.st_ino, state.st_size, path.read_bytes()))

    monkeypatch.setattr(os, "fsync", note)
    write_atomically(path, NEW)
    assert path.read_bytes() == NEW
    # All of the new file, while the name still stood for the old one; and then the name.
    folder = path.parent.stat()
    assert synced == [(path.stat().st_ino, len(NEW), OLD), (folder.st_ino, folder.st_size, NEW)]


def synced_folders(monkeypatch: pytest.MonkeyPatch, names_in: Path) -> list[tuple[int, set[str]]]:
    """A list that gets each folder that is synced, with the names that another one has then."""
    found, sync = list[tuple[int, set[str]]](), os.fsync

    def note(descriptor: int) -> None:
        sync(descriptor)
        state = os.fstat(descriptor)
        if stat.S_ISDIR(state.st_mode):
            found.append((state.st_ino, {one.name for one in names_in.iterdir()}))

    monkeypatch.setattr(os, "fsync", note)
    return found


def test_the_name_that_a_link_leads_to_is_on_the_disk(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    links = path.parent / "links"
    links.mkdir()
    link = links / path.name
    link.symlink_to(path)
    found = synced_folders(monkeypatch, links)
    write_atomically(link, NEW)
    assert found == [(path.parent.stat().st_ino, {path.name})]
    assert path.read_bytes() == NEW


def test_names_of_an_archive_and_of_what_is_restored_are_on_the_disk(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, archive, target = tmp_path / "service.toml", tmp_path / "kept" / "service.tar.gz", tmp_path / "restored"
    config.write_text("")
    archive.parent.mkdir()
    found = synced_folders(monkeypatch, archive.parent)
    write_archive(archive, "beamtouch-service", config, [Part(config), Part(path)])
    assert found == [(archive.parent.stat().st_ino, {archive.name})]
    found.clear()
    restore_archive(archive, target, None)
    assert sorted(inode for inode, _ in found) == sorted([tmp_path.stat().st_ino, target.stat().st_ino])


@pytest.mark.parametrize(("number", "is_refused"), [(errno.EINVAL, False), (errno.EIO, True)])
def test_a_file_system_that_syncs_no_folders_is_left_to_the_system(
    path: Path, monkeypatch: pytest.MonkeyPatch, number: int, is_refused: bool
) -> None:
    sync = os.fsync

    def fail(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(number, os.strerror(number))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="Input/output error") if is_refused else nullcontext():
        write_atomically(path, NEW)
    assert path.read_bytes() == NEW


@pytest.mark.parametrize("fails", ["fsync", "fchmod", "replace"])
def test_a_write_that_fails_leaves_the_old_file_and_nothing_beside_it(
    path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, fails, fail) if fails != "replace" else monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OSError, match="No space left") as failure:
        write_atomically(path, NEW, mode=0o644)
    assert failure.value.filename == str(path)
    assert {one.name: one.read_bytes() for one in path.parent.iterdir()} == {path.name: OLD}


def test_the_content_of_an_archive_and_of_what_is_restored_is_on_the_disk_before_it_has_its_name(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced, sync = list[tuple[str, int]](), os.fsync

    def note(descriptor: int) -> None:
        sync(descriptor)
        name = Path(f"/proc/self/fd/{descriptor}").readlink().name
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            synced.append((name, os.fstat(descriptor).st_size))

    monkeypatch.setattr(os, "fsync", note)
    archive, new = path.parent / "a.tar.gz", path.parent / "new"
    write_archive(archive, "test", path, [Part(path)])
    restore_archive(archive, new, None)
    (written, size), (restored, length) = synced
    assert (size, length) == (archive.stat().st_size, len(OLD))
    assert (written.startswith(".a.tar.gz."), restored.startswith(f".{path.name}.")) == (True, True)
