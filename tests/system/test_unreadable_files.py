"""Files that a configuration includes or names and that cannot be read: one line that names the file and the reason.

One that may come later ends the program with 1, as the service manager starts it again; any other one, and one whose
contents are wrong, ends it with 2.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from beamtouch_daemon import cli as daemon_cli
from beamtouch_service import cli as service_cli
from support.programs.in_process import command_of
from support.surfaces import configs


def folder(path: Path) -> None:
    path.mkdir()


def dangling_link(path: Path) -> None:
    path.symlink_to("gone")


def no_text(path: Path) -> None:
    path.write_bytes(b"\xff\xfe\x00")


def endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


def of_windows(path: Path) -> None:
    path.write_text('{"surface": "bench"}\n', encoding="utf-16")


Reasons = dict[Callable[[Path], None], str]
ABSENT: Reasons = {folder: "Is a directory", dangling_link: "No such file or directory"}
IN_UTF_16 = {of_windows: "in UTF-16; save it as UTF-8"}
NO_TOKEN = ABSENT | IN_UTF_16 | {no_text: "more than one word of printable ASCII", endless: "longer than 4096 bytes"}
NO_PASSWORD = ABSENT | IN_UTF_16 | {no_text: "not one line of text", endless: "not one line of text"}
TOO_LARGE = "larger than 1 MiB; is it the right file?"
DAEMON = configs.PUBLISH + configs.surface()
ENDS_WITH_1: dict[str, tuple[str, Reasons]] = {
    "daemon publish.token_file": (DAEMON.replace("beamtouch.token", "one.named"), NO_TOKEN),
    "daemon publish.certificate_file": (
        DAEMON.replace("[publish]", '[publish]\ncertificate_file = "one.named"'),
        ABSENT | {no_text: "contains no PEM certificate", endless: "contains no PEM certificate"},
    ),
    "daemon tare_file": (
        DAEMON.replace("rate_hz", 'tare_file = "one.named"\nrate_hz', 1),
        {folder: ABSENT[folder], no_text: "not a tare file", of_windows: "in UTF-16, not in UTF-8", endless: TOO_LARGE},
    ),
    "service server.write_token_file": ('[server]\nwrite_token_file = "one.named"\n', NO_TOKEN),
    "service server.read_token_file": ('[server]\nread_token_file = "one.named"\n', NO_TOKEN),
    "service server.certificate_file": (
        '[server]\ncertificate_file = "one.named"\nkey_file = "one.named"\n',
        ABSENT | dict.fromkeys((no_text, endless), "are not a PEM certificate and its key without a passphrase"),
    ),
    "service mqtt.ca_file": (
        '[mqtt]\nhost = "b"\ntls = true\nca_file = "one.named"\n',
        ABSENT | {no_text: "not PEM", endless: "not PEM"},
    ),
    "service mqtt.certificate_file": (
        '[mqtt]\nhost = "b"\ntls = true\ncertificate_file = "one.named"\nkey_file = "one.named"\n',
        ABSENT | dict.fromkeys((no_text, endless), "are not a PEM certificate and its key without a passphrase"),
    ),
    "service mqtt.password_file": ('[mqtt]\nhost = "b"\nusername = "u"\npassword_file = "one.named"\n', NO_PASSWORD),
    "service opcua.password_file": ('[opcua]\nusername = "u"\npassword_file = "one.named"\n', NO_PASSWORD),
    "service opcua.certificate_file": (
        '[opcua]\ncertificate_file = "one.named"\nkey_file = "one.named"\n',
        ABSENT | {no_text: "not a PEM or DER certificate", endless: TOO_LARGE},
    ),
}
"""Configurations by program and key, each with its reasons. A file that is absent ends the program with 1.

Models have tests of their own: a service also runs without them.
"""
ENDS_WITH_2: dict[str, tuple[str, Reasons]] = {
    # No pattern of an include matches a folder.
    "daemon include": (
        f'include = ["*.named"]\n{DAEMON}',
        {
            dangling_link: ABSENT[dangling_link],
            no_text: "not a text file in UTF-8",
            of_windows: "in UTF-16, not in UTF-8; save it as UTF-8",
            endless: TOO_LARGE,
        },
    ),
}
"""The same; a file that is absent ends the program with 2."""
WRONG = {no_text, of_windows, endless}
"""What makes files whose contents are wrong."""
CONFIGURATIONS = ENDS_WITH_1 | ENDS_WITH_2


@pytest.mark.parametrize(
    ("key", "make"), [(key, make) for key, (_, reasons) in CONFIGURATIONS.items() for make in reasons]
)
def test_a_file_that_cannot_be_read_is_one_line_with_its_reason(
    key: str, make: Callable[[Path], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, reasons = CONFIGURATIONS[key]
    (tmp_path / "beamtouch.token").write_text(configs.TOKEN)
    (tmp_path / "config.toml").write_text(text)
    make(tmp_path / "one.named")
    if key.startswith("daemon"):
        done = command_of(daemon_cli.main, capsys)("run", tmp_path / "config.toml")
    else:
        done = command_of(service_cli.main, capsys)("run", "--port", 0, "--config", tmp_path / "config.toml")
    code = 1 if key in ENDS_WITH_1 and make not in WRONG else 2
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (code, "", 1), done.stderr
    assert str(tmp_path / "one.named") in done.stderr
    assert reasons[make] in done.stderr
