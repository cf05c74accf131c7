"""A service that runs is backed up, and restored elsewhere: the same events, the same trail, the same answers."""

import os
import signal
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from service.bench import TOKEN, BuildModel, batch_of
from service.event_story import RESTING, TOUCHING
from service.process.conftest import Command, Process, Service, StartService, service_of
from support.running.waiting import wait_until

CONFIG = """
[server]
port = 0
write_token_file = "token"
[events]
file = "record/events.db"
[surfaces.press-7]
model = "press-7.onnx"
stale_ms = 60000
"""


def answers(service: Service) -> list[Any]:
    """Return the events with their paths, the trail and the model."""
    paths = ("/events?path=true&limit=50", "/audit", "/surfaces/press-7/model")
    return [service.get(path, TOKEN).json() for path in paths]


def done(process: Process) -> tuple[int, str, str]:
    said, errors = process.communicate(timeout=60)
    return process.wait(), said, errors


@pytest.fixture
def line(start_service: StartService, build_model: BuildModel, tmp_path: Path) -> Service:
    """A service with a contact on record, in the folder of the test."""
    for name in ("press-7", "press-7.candidate", "press-7.previous"):
        build_model(name)
    (tmp_path / "record").mkdir()
    (tmp_path / "service.toml").write_text(CONFIG)
    service = start_service("--config", "service.toml")
    rows = [RESTING, *[TOUCHING] * 5, RESTING]
    assert service.post(batch_of(*rows) | {"oldest": 1, "characteristic": "c1"}).is_success
    wait_until(lambda: len(service.get("/audit", TOKEN).json()["entries"]) == 4)
    wait_until(lambda: bool(service.get("/events", TOKEN).json()["events"]))
    return service


@pytest.mark.promise("docs/how-to/backup.md", "while it runs")
@pytest.mark.promise("docs/reference/trail.md", "With the record, the trail is in")
def test_a_running_service_is_backed_up_and_restored_on_a_bare_machine(
    line: Service, command: Command, tmp_path: Path
) -> None:
    config, archive, new = tmp_path / "service.toml", tmp_path / "a.tar.gz", tmp_path / "new"
    code, said, errors = done(command("backup", "--config", config, "-o", archive, "--with-secrets"))
    assert (code, errors) == (0, "")
    assert said.splitlines() == [
        "folder/service.toml",
        "folder/token",
        "folder/press-7.onnx",
        "folder/press-7.candidate.onnx",
        "folder/press-7.previous.onnx",
        "folder/record/events.db",
    ]
    before = answers(line)
    line.stop(signal.SIGTERM)
    code, said, errors = done(command("restore", archive, new))
    assert (code, errors, len(said.splitlines())) == (0, "", 6)
    restored = service_of(command("run", "--config", new / "service.toml"), TOKEN)
    assert restored.get("/events", TOKEN).json()["events"][0]["end"] == "lift"
    assert before[1]["chain"]["holds"]
    events, trail, model = answers(restored)
    assert (events, model) == (before[0], before[2])
    # It adds to the trail what is new about it: the configuration is the same, and its folder is an option.
    assert trail["entries"][-4:] == before[1]["entries"]
    assert trail["chain"]["holds"]
    assert restored.post(batch_of(TOUCHING, sequence=8)).json()["expected"] == 9


def test_tokens_are_in_a_backup_only_if_they_are_asked_for(line: Service, command: Command, tmp_path: Path) -> None:
    archive = tmp_path / "a.tar.gz"
    code, said, _ = done(command("backup", "--config", tmp_path / "service.toml", "-o", archive))
    assert (code, said.splitlines()[-1]) == (0, f"left out: {tmp_path}/token (--with-secrets)")
    code, said, _ = done(command("restore", archive, tmp_path / "new"))
    assert (code, (tmp_path / "new" / "token").exists()) == (0, False)
    assert line.get("/health/live").is_success


@pytest.mark.promise("docs/how-to/backup.md", "A backup that a signal ends leaves nothing behind")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_backup_that_a_signal_ends_leaves_nothing_behind(
    command: Command, tmp_path: Path, number: int, code: int
) -> None:
    (tmp_path / "service.toml").write_text('[surfaces.press-7]\nmodel = "press-7.onnx"\n')
    # A pipe is read once for its digest; then the archive is begun, and waits for what nobody writes.
    os.mkfifo(tmp_path / "press-7.onnx")
    before = sorted(tmp_path.iterdir())
    backup = command("backup", "--config", tmp_path / "service.toml", "-o", tmp_path / "a.tar.gz")
    (tmp_path / "press-7.onnx").write_bytes(b"model")
    wait_until(lambda: bool(list(tmp_path.glob(".a.tar.gz.*.partial"))))
    assert list(tmp_path.glob(".backup-*"))
    backup.send_signal(number)
    assert done(backup)[0] == code
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_without_certificates_yet_is_in_the_backup(
    command: Command, certificate: tuple[Path, Path], tmp_path: Path
) -> None:
    files = f"certificate_file = '{certificate[0]}'\nkey_file = '{certificate[1]}'\n"
    (tmp_path / "service.toml").write_text(f"[opcua]\n{files}trusted_folder = 'clients'\n")
    (tmp_path / "clients").mkdir()
    code, said, _ = done(command("backup", "--config", tmp_path / "service.toml", "-o", tmp_path / "a.tar.gz"))
    assert (code, "folder/clients/" in said.splitlines()) == (0, True)
    assert done(command("restore", tmp_path / "a.tar.gz", tmp_path / "new"))[0] == 0
    assert (tmp_path / "new" / "clients").is_dir()


@pytest.mark.parametrize("named", ["both.pem", "link.pem"])
def test_a_file_with_a_key_is_a_secret_whatever_else_it_is(command: Command, tmp_path: Path, named: str) -> None:
    config, archive = tmp_path / "service.toml", tmp_path / "a.tar.gz"
    config.write_text(
        '[server]\ncertificate_file = "both.pem"\nkey_file = "both.pem"\n'
        f'[mqtt]\nhost = "127.0.0.1"\ntls = true\nca_file = "{named}"\n'
    )
    (tmp_path / "both.pem").write_text("a certificate and its key\n")
    (tmp_path / "link.pem").symlink_to("both.pem")
    code, said, errors = done(command("backup", "--config", config, "-o", archive))
    left_out = [f"left out: {tmp_path}/{name} (--with-secrets)" for name in sorted({"both.pem", named})]
    assert (code, errors, said.splitlines()) == (0, "", ["folder/service.toml", *left_out])


def test_a_damaged_or_a_missing_record_is_no_backup(command: Command, build_model: BuildModel, tmp_path: Path) -> None:
    build_model()
    (tmp_path / "token").write_text(TOKEN)
    (tmp_path / "service.toml").write_text(CONFIG)
    backup = ("backup", "--config", tmp_path / "service.toml", "-o", tmp_path / "a.tar.gz")
    code, _, errors = done(command(*backup))
    assert (code, errors.count("\n")) == (1, 1)
    assert "record/events.db: unable to open database file; there is no backup" in errors
    (tmp_path / "record").mkdir()
    with closing(sqlite3.connect(tmp_path / "record" / "events.db")) as record:
        record.execute("CREATE TABLE many (text)")
        record.executemany("INSERT INTO many VALUES (?)", [("x" * 500,)] * 100)
        record.commit()
    content = bytearray((tmp_path / "record" / "events.db").read_bytes())
    content[4096:12288] = b"y" * 8192
    (tmp_path / "record" / "events.db").write_bytes(content)
    code, _, errors = done(command(*backup))
    assert (code, errors.count("\n")) == (1, 1)
    assert "there is no backup" in errors
    assert not list(tmp_path.glob("*.tar.gz")) + list(tmp_path.glob(".backup*"))
