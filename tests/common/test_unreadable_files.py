"""Files that a configuration includes or names and that cannot be read: one line that names the file and the reason.

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
COMES_LATER = {
    "daemon publish.token_file": DAEMON.replace("beamtouch.token", "one.named"),
    "daemon publish.certificate_file": DAEMON.replace("[publish]", '[publish]\ncertificate_file = "one.named"'),
    "service server.write_token_file": '[server]\nwrite_token_file = "one.named"\n',
    "service server.read_token_file": '[server]\nread_token_file = "one.named"\n',
    "service server.certificate_file": '[server]\ncertificate_file = "one.named"\nkey_file = "one.named"\n',
    "service mqtt.password_file": '[mqtt]\nhost = "b"\nusername = "u"\npassword_file = "one.named"\n',
    "service opcua.password_file": '[opcua]\nusername = "u"\npassword_file = "one.named"\n',
    "service opcua.certificate_file": '[opcua]\ncertificate_file = "one.named"\nkey_file = "one.named"\n',
}
IS_THERE = {
    "daemon include": f'include = ["*.named"]\n{DAEMON}',  # no pattern matches a folder
    "service mqtt.ca_file": '[mqtt]\nhost = "b"\ntls = true\nca_file = "one.named"\n',
}
"""Configurations by program and key. Models have tests of their own: a service also runs without them."""
REASONS: dict[Callable[[Path], None], str] = {
    folder: "Is a directory",
    dangling_link: "No such file or directory",
    no_text: "",
}


@pytest.mark.parametrize("make", REASONS)
@pytest.mark.parametrize("key", [*COMES_LATER, *IS_THERE])
def test_a_file_that_cannot_be_read_is_one_line_with_its_reason(
    key: str, make: Callable[[Path], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "beamtouch.token").write_text(TOKEN)
    (tmp_path / "config.toml").write_text((COMES_LATER | IS_THERE)[key])
    make(tmp_path / "one.named")
    if key.startswith("daemon"):
        done = command_of(daemon_cli.main, capsys)("run", tmp_path / "config.toml")
    else:
        done = command_of(service_cli.main, capsys)("run", "--port", 0, "--config", tmp_path / "config.toml")
    code = 1 if key in COMES_LATER and make is not no_text else 2
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (code, "", 1), done.stderr
    is_unmatched = (key, make) == ("daemon include", folder)
    for words in (
        ("include: no file matches '*.named'",) if is_unmatched else (str(tmp_path / "one.named"), REASONS[make])
    ):
        assert words in done.stderr
