"""A file that is replaced is on the disk before it has its name: a loss of power leaves the old one or the new one."""

import os
from pathlib import Path

import pytest

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
    # All of the new file, while the name still stood for the old one.
    assert synced == [(path.stat().st_ino, len(NEW), OLD)]


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
