"""Files that a configuration includes or names and that cannot be read: one line that names the file.

One that may come later ends the program with 1, as the service manager starts it again; any other one ends it with 2.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from beamtouch_daemon import cli as daemon_cli
from beamtouch_service import cli as service_cli
from daemon import configs
from daemon.service import TOKEN
from in_process import command_of


def folder(path: Path) -> None:
    path.mkdir()


def dangling_link(path: Path) -> None:
    path.symlink_to("gone")


def no_text(path: Path) -> None:
    path.write_bytes(b"\xff\xfe\x00")


DAEMON = configs.PUBLISH + configs.surface()
INCLUDING = f'include = ["*.named"]\n{DAEMON}'
NAMING = {
    "token_file": DAEMON.replace("beamtouch.token", "one.named"),
    "certificate_file": DAEMON.replace("[publish]", '[publish]\ncertificate_file = "one.named"'),
}
"""Configurations of the daemon."""
SERVING = {
    "write_token_file": '[server]\nwrite_token_file = "one.named"\n',
    "read_token_file": '[server]\nread_token_file = "one.named"\n',
    "certificate_file": '[server]\ncertificate_file = "one.named"\nkey_file = "one.named"\n',
    "mqtt.password_file": '[mqtt]\nhost = "b"\nusername = "u"\npassword_file = "one.named"\n',
    "opcua.password_file": '[opcua]\nusername = "u"\npassword_file = "one.named"\n',
    "opcua.certificate_file": '[opcua]\ncertificate_file = "one.named"\nkey_file = "one.named"\n',
}
"""Configurations of the service. It also runs without its model files."""
SERVE: tuple[object, ...] = ("run", "--port", 0, "--config")
CA_FILE = '[mqtt]\nhost = "b"\ntls = true\nca_file = "one.named"\n'


@pytest.mark.parametrize(("make", "code"), [(folder, 1), (dangling_link, 1), (no_text, 2)])
@pytest.mark.parametrize(
    ("main", "words", "text"),
    [
        *(pytest.param(daemon_cli.main, ("run",), text, id=f"daemon {key}") for key, text in NAMING.items()),
        *(pytest.param(service_cli.main, SERVE, text, id=f"service {key}") for key, text in SERVING.items()),
    ],
)
def test_a_named_file_that_cannot_be_read_is_one_line(
    main: Callable[[list[str]], int],
    words: tuple[object, ...],
    text: str,
    make: Callable[[Path], None],
    code: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "beamtouch.token").write_text(TOKEN)
    (tmp_path / "config.toml").write_text(text)
    make(tmp_path / "one.named")
    done = command_of(main, capsys)(*words, tmp_path / "config.toml")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (code, "", 1), done.stderr
    assert str(tmp_path / "one.named") in done.stderr


@pytest.mark.parametrize(
    ("main", "words", "text", "make", "said"),
    [
        (daemon_cli.main, ("check",), INCLUDING, folder, "config.toml: include: no file matches '*.named'"),
        (daemon_cli.main, ("check",), INCLUDING, dangling_link, "one.named: No such file or directory"),
        (daemon_cli.main, ("check",), INCLUDING, no_text, "one.named: not a text file in UTF-8"),
        (service_cli.main, SERVE, CA_FILE, folder, "one.named: Is a directory"),
        (service_cli.main, SERVE, CA_FILE, dangling_link, "one.named: No such file or directory"),
        (service_cli.main, SERVE, CA_FILE, no_text, "one.named: not PEM"),
    ],
)
def test_an_included_file_that_cannot_be_read_and_certificates_of_mqtt_are_wrong_input(
    main: Callable[[list[str]], int],
    words: tuple[object, ...],
    text: str,
    make: Callable[[Path], None],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "config.toml").write_text(text)
    make(tmp_path / "one.named")
    done = command_of(main, capsys)(*words, tmp_path / "config.toml")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert done.stderr.partition(": ")[2].startswith(f"{tmp_path}/{said}")
