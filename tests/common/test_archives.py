"""Archives of backups: all of it or nothing, and never a file outside of the target."""

import hashlib
import io
import json
import os
import subprocess
import sys
import tarfile
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from beamtouch_common.archives import Part, restore_archive, write_archive
from beamtouch_common.errors import FailedError, InputError

Change = Callable[[dict[str, bytes]], None]


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    """A folder with a configuration, a model in a folder of it, and a secret; another file lies elsewhere."""
    folder = tmp_path / "plant"
    (folder / "models").mkdir(parents=True)
    (folder / "service.toml").write_text("[server]\n")
    (folder / "models" / "press.onnx").write_bytes(os.urandom(3_000_000))
    (folder / "token").write_text("correct-horse-battery-staple\n")
    (tmp_path / "elsewhere").write_text("other\n")
    return folder


def write(plant: Path, *, elsewhere: bool = False) -> Path:
    config, archive = plant / "service.toml", plant.parent / "a.tar.gz"
    parts = [Part(config), Part(plant / "models" / "press.onnx"), Part(plant / "token", is_secret=True)]
    write_archive(archive, "test", config, parts + [Part(plant.parent / "elsewhere")] * elsewhere)
    return archive


def found(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_was_written_comes_back_the_same_and_a_secret_stays_one(plant: Path, tmp_path: Path) -> None:
    archive, new = write(plant), tmp_path / "deep" / "new"
    assert archive.stat().st_mode & 0o777 == 0o600
    restored = restore_archive(archive, new, None)
    assert found(new) == found(plant)
    assert sorted(restored) == sorted(new / name for name in found(plant))
    assert (new / "token").stat().st_mode & 0o777 == 0o600
    assert [path.name for path in tmp_path.glob(".*")] == []


@pytest.mark.promise("docs/how-to/backup.md", "It overwrites nothing")
def test_nothing_is_overwritten_neither_by_a_backup_nor_by_a_restore(plant: Path, tmp_path: Path) -> None:
    archive, new = write(plant), tmp_path / "new"
    before = archive.read_bytes()
    with pytest.raises(InputError, match="is there already; name another one"):
        write(plant)
    assert archive.read_bytes() == before
    new.mkdir()
    (new / "token").symlink_to("nowhere")
    with pytest.raises(InputError, match=r"new/token: there already; a restore overwrites nothing"):
        restore_archive(archive, new, None)
    assert found(new) == {}


@pytest.mark.parametrize("end", ["-wal", "-shm", "-journal"])
def test_a_record_is_not_restored_beside_what_sqlite_kept_of_another_one(plant: Path, tmp_path: Path, end: str) -> None:
    """SQLite would write a log that it finds beside a record into it."""
    archive, new = write(plant), tmp_path / "new"
    new.mkdir()
    (new / f"service.toml{end}").write_bytes(b"old")
    with pytest.raises(InputError, match=rf"new/service.toml{end}: there already"):
        restore_archive(archive, new, None)
    assert found(new) == {f"service.toml{end}": b"old"}


@pytest.mark.parametrize("is_secret_first", [True, False])
def test_a_file_that_is_named_twice_is_written_once_and_a_secret_stays_one(
    plant: Path, tmp_path: Path, *, is_secret_first: bool
) -> None:
    config, token, archive = plant / "service.toml", plant / "models" / ".." / "token", tmp_path / "a.tar.gz"
    tokens = [Part(plant / "token", is_secret=True), Part(token)]
    parts = [Part(config), *(tokens if is_secret_first else reversed(tokens)), Part(config)]
    assert write_archive(archive, "test", config, parts) == ["folder/service.toml", "folder/token"]
    restore_archive(archive, tmp_path / "new", None)
    assert sorted(found(tmp_path / "new")) == ["service.toml", "token"]
    assert (tmp_path / "new" / "token").stat().st_mode & 0o777 == 0o600


@pytest.mark.promise("docs/how-to/backup.md", "a folder in which there is nothing is restored, too")
def test_an_empty_folder_comes_back_unless_a_file_has_its_place(plant: Path, tmp_path: Path) -> None:
    (plant / "clients").mkdir()
    parts = [Part(plant / "service.toml"), Part(plant / "clients")]
    names = write_archive(tmp_path / "a.tar.gz", "test", plant / "service.toml", parts)
    assert names == ["folder/service.toml", "folder/clients/"]
    assert restore_archive(tmp_path / "a.tar.gz", tmp_path / "new", None)[1] == tmp_path / "new" / "clients"
    assert list((tmp_path / "new" / "clients").iterdir()) == []
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "clients").write_text("a file")
    with pytest.raises(InputError, match=r"other/clients: there already"):
        restore_archive(tmp_path / "a.tar.gz", tmp_path / "other", None)
    assert found(tmp_path / "other") == {"clients": b"a file"}


def test_a_snapshot_has_the_mode_of_its_file(plant: Path, tmp_path: Path) -> None:
    record, copy, archive = plant / "events.db", tmp_path / "copy", tmp_path / "a.tar.gz"
    record.write_bytes(b"a")
    copy.write_bytes(b"ab")
    record.chmod(0o640)
    copy.chmod(0o644)
    write_archive(archive, "test", plant / "service.toml", [Part(record, copy)])
    (restored,) = restore_archive(archive, tmp_path / "new", None)
    assert (restored.read_bytes(), restored.stat().st_mode & 0o777) == (b"ab", 0o640)


def test_a_file_that_changes_meanwhile_is_no_backup(plant: Path, tmp_path: Path) -> None:
    """The size of a file in /proc is 0, whatever it holds."""
    parts = [Part(plant / "service.toml"), Part(plant / "uptime", Path("/proc/self/status"))]
    (plant / "uptime").touch()
    with pytest.raises(FailedError, match=r"b.tar.gz: a file changed while it was read; there is no backup: try again"):
        write_archive(tmp_path / "b.tar.gz", "test", plant / "service.toml", parts)
    assert not list(tmp_path.glob("*b.tar.gz*"))


def test_a_target_below_a_file_is_said_in_one_line(plant: Path) -> None:
    with pytest.raises(FailedError, match="Not a directory; there is no backup"):
        write_archive(plant / "token" / "a", "test", plant / "service.toml", [Part(plant / "token")])


def test_files_from_elsewhere_need_a_root(plant: Path, tmp_path: Path) -> None:
    archive, new = write(plant, elsewhere=True), tmp_path / "new"
    with pytest.raises(InputError, match=rf"{tmp_path}/elsewhere is not from the folder .* add --root /"):
        restore_archive(archive, new, None)
    assert not new.exists()
    restore_archive(archive, new, tmp_path / "root")
    assert found(tmp_path / "root") == {f"{tmp_path}/elsewhere"[1:]: b"other\n"}


def content_of(archive: tarfile.TarFile, name: str) -> bytes:
    """Return the content of a member."""
    file = archive.extractfile(name)
    assert file is not None, name
    return file.read()


def rewrite(archive: Path, change: Change) -> None:
    """Write an archive anew whose members were changed."""
    with tarfile.open(archive) as before:
        members = {name: content_of(before, name) for name in before.getnames()}
    change(members)
    with tarfile.open(archive, "w:gz") as after:
        for name, content in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            after.addfile(member, io.BytesIO(content))


def rename(name: str) -> Change:
    """Return a change that gives the token another name, also in the list."""

    def change(members: dict[str, bytes]) -> None:
        members["list.json"] = members["list.json"].replace(b'"folder/token"', json.dumps(name).encode())
        members[name] = members.pop("folder/token")

    return change


def edit(name: str) -> Change:
    return lambda members: members.update({name: b"edited"})


def drop(name: str) -> Change:
    def change(members: dict[str, bytes]) -> None:
        del members[name]

    return change


CHANGES: dict[str, tuple[Change, str]] = {
    "a path upwards": (rename("folder/../../token"), "would leave the folder"),
    "a path from the root": (rename("/etc/token"), "would leave the folder"),
    "no path": (rename("folder"), "would leave the folder"),
    "a file with other content": (edit("folder/token"), "folder/token is not as its list says"),
    "a file too many": (edit("folder/more"), "files that its list does not have"),
    "a file too few": (drop("folder/token"), "folder/token is not as its list says"),
    "another list": (edit("list.json"), "its list: Invalid JSON"),
    "no list": (drop("list.json"), "it has no list"),
}


@pytest.mark.parametrize("how", CHANGES)
def test_an_archive_that_was_changed_is_refused_whole(plant: Path, tmp_path: Path, how: str) -> None:
    archive, (change, problem) = write(plant), CHANGES[how]
    rewrite(archive, change)
    before = found(tmp_path)
    with pytest.raises(InputError, match=problem):
        restore_archive(archive, tmp_path / "new", None)
    assert found(tmp_path) == before
    assert not (tmp_path / "new").exists()


def test_links_in_an_archive_or_in_the_target_lead_nowhere(plant: Path, tmp_path: Path) -> None:
    archive = write(plant)
    (tmp_path / "new").mkdir()
    (tmp_path / "outside").mkdir()
    (tmp_path / "new" / "models").symlink_to(tmp_path / "outside")
    with pytest.raises(InputError, match="a link leads out of"):
        restore_archive(archive, tmp_path / "new", None)
    with tarfile.open(archive) as before:
        listed = content_of(before, "list.json")
    with tarfile.open(archive, "w:gz") as after:
        first, link = tarfile.TarInfo("list.json"), tarfile.TarInfo("folder/service.toml")
        first.size, link.type, link.linkname = len(listed), tarfile.SYMTYPE, "/etc/passwd"
        after.addfile(first, io.BytesIO(listed))
        after.addfile(link)
    with pytest.raises(InputError, match=r"folder/service.toml is not a file"):
        restore_archive(archive, tmp_path / "other", None)
    assert found(tmp_path / "outside") == {}


@pytest.mark.parametrize("keep", [0, 100, 1_000_000])
def test_a_torn_archive_is_refused(plant: Path, tmp_path: Path, keep: int) -> None:
    archive = write(plant)
    archive.write_bytes(archive.read_bytes()[:keep])
    with pytest.raises(InputError, match="not a whole archive of `backup`") as refusal:
        restore_archive(archive, tmp_path / "new", None)
    assert str(refusal.value).count("whole archive") == 1
    assert not (tmp_path / "new").exists()


FULL = """
import resource, sys
from pathlib import Path
from beamtouch_common.archives import Part, restore_archive, write_archive
from beamtouch_common.errors import FailedError
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
plant = Path(sys.argv[1])
try:
    if sys.argv[2] == "backup":
        parts = [Part(plant / "models" / "press.onnx")]
        write_archive(plant.parent / "b.tar.gz", "test", plant / "service.toml", parts)
    else:
        restore_archive(plant.parent / "a.tar.gz", plant.parent / "new", None)
except FailedError as error:
    print(error)
"""


@pytest.mark.parametrize("command", ["backup", "restore"])
def test_a_full_disk_leaves_nothing_behind(plant: Path, tmp_path: Path, command: str) -> None:
    write(plant)
    before = found(tmp_path)
    done = subprocess.run([sys.executable, "-c", FULL, plant, command], capture_output=True, text=True, check=True)
    assert "File too large; " in done.stdout
    assert ("there is no backup" if command == "backup" else "nothing was restored") in done.stdout
    assert found(tmp_path) == before
    assert not (tmp_path / "new").exists()


def test_a_file_that_cannot_be_read_is_named(plant: Path, tmp_path: Path) -> None:
    with pytest.raises(FailedError, match=r"gone.onnx: No such file or directory; there is no backup"):
        write_archive(tmp_path / "b", "test", plant / "service.toml", [Part(plant / "gone.onnx")])
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize(("mode", "restored"), [(0o777, 0o755), (0o640, 0o640), (0o600, 0o600), (0o531, 0o511)])
def test_a_file_comes_back_with_its_mode_but_only_its_owner_may_change_it(
    plant: Path, tmp_path: Path, mode: int, restored: int
) -> None:
    config, archive = plant / "service.toml", tmp_path / "a.tar.gz"
    config.chmod(mode)
    write_archive(archive, "test", config, [Part(config)])
    (back,) = restore_archive(archive, tmp_path / "new", None)
    assert back.stat().st_mode & 0o777 == restored


def test_the_first_three_files_that_are_there_already_are_named(plant: Path, tmp_path: Path) -> None:
    names = ["service.toml", "a", "b", "c"]
    for name in names[1:]:
        (plant / name).touch()
    write_archive(tmp_path / "a.tar.gz", "test", plant / "service.toml", [Part(plant / name) for name in names])
    with pytest.raises(InputError) as refused:
        restore_archive(tmp_path / "a.tar.gz", plant, None)
    three = ", ".join(str(plant / name) for name in names[:3])
    assert str(refused.value) == f"{three}: there already; a restore overwrites nothing: move it away"


def test_an_archive_begins_with_who_made_it_and_what_is_in_it(plant: Path) -> None:
    with tarfile.open(write(plant)) as archive:
        listed = json.loads(content_of(archive, "list.json"))
        members = {member.name: (member.size, member.mode) for member in archive.getmembers()}
    assert next(iter(members)) == "list.json"
    assert (listed["format"], listed["program"]) == (1, "test")
    assert datetime.fromisoformat(listed["made_at"]).utcoffset() == timedelta(0)
    for one in listed["files"]:
        content = (plant / one["name"].removeprefix("folder/")).read_bytes()
        assert one["sha256"] == hashlib.sha256(content).hexdigest()
        assert members[one["name"]] == (one["bytes"], one["mode"]) == (len(content), one["mode"])


def test_a_restore_that_is_interrupted_leaves_nothing_behind(
    plant: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = write(plant)
    rename, done = Path.rename, list[Path]()

    def interrupt(path: Path, target: Path) -> Path:
        if done:
            raise KeyboardInterrupt
        done.append(target)
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", interrupt)
    with pytest.raises(KeyboardInterrupt):
        restore_archive(archive, tmp_path / "new", None)
    assert len(done) == 1
    assert not (tmp_path / "new").exists()
