"""`init`: what it writes from options, and what it refuses."""

import json
import stat
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from beamtouch_daemon.cli import main
from unprivileged import without_root

from . import configs
from .devices import SerialDevice, StampingUnit, pymodbus_server, rtu_units
from .lines import terminal
from .process import Outcome, command

pytestmark = pytest.mark.anyio

TEMPLATE = (
    """\
# Acquisition of the surface "bench".
"""
    + configs.PUBLISH.replace("batch_ms", "# kept\nbatch_ms")
    + configs.surface('"bench"').replace('name = "s1"', 'name = "s1"     # mounted 35 mm from the left end')
)


def template(folder: Path) -> Path:
    """Write what `design-sensors build --daemon-config` writes, in a folder of its own, and a token for the result."""
    (folder / "built").mkdir()
    path = folder / "built" / "bench.daemon.toml"
    path.write_text(TEMPLATE)
    (folder / "beamtouch.token").write_text("swordfish-of-the-tests")
    return path


def content(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text())


async def init(folder: Path, *options: str | Path) -> Outcome:
    return await command("init", folder / "daemon.toml", "--model-config", template(folder), *options)


async def test_a_configuration_for_modbus_tcp_passes_check_and_keeps_what_belongs_to_the_model(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_000]) as port:
        source = f"tcp://127.0.0.1:{port}"
        options = ("--unit", "1", "--timeout-ms", "30000", "--url", "https://beams.example:8420/")
        written = await init(tmp_path, "--source", source, *options)
        checked = await command("check", tmp_path / "daemon.toml")
    assert (written.code, written.err) == (0, "")
    path = tmp_path / "daemon.toml"
    assert written.out.startswith(f"{path}: bench, channels s1, s2, 200 readings per second from {source}\n")
    assert f"next: beamtouch-daemon check {path} --wait 30\n" in written.out
    assert checked.code == 0, checked.err
    told, known = content(path), tomllib.loads(TEMPLATE)
    assert told["surfaces"]["bench"].pop("source") == {
        "kind": "modbus-tcp",
        "host": "127.0.0.1",
        "port": port,
        "unit": 1,
        "timeout_ms": 30_000,
    }
    known["surfaces"]["bench"].pop("source")
    assert told["surfaces"] == known["surfaces"]
    assert told["publish"] == {"url": "https://beams.example:8420", "token_file": "beamtouch.token", "batch_ms": 20}
    assert "# mounted 35 mm from the left end" in path.read_text()
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


async def test_configurations_for_a_bus_and_for_a_board_pass_check(tmp_path: Path) -> None:
    with terminal() as bus, terminal() as line:
        SerialDevice(line)
        async with rtu_units(bus, {7: StampingUnit()}):
            options = ("--baud", "19200", "--parity", "none", "--unit", "7", "--function", "3", "--timeout-ms", "30000")
            rtu = await init(tmp_path, "--source", f"rtu:{bus.path}", *options)
            source = content(tmp_path / "daemon.toml")["surfaces"]["bench"]["source"]
            reads = await command("check", tmp_path / "daemon.toml", "--json")
        model = ("--model-config", tmp_path / "built" / "bench.daemon.toml")
        serial = await command(
            "init", tmp_path / "daemon.toml", *model, "--source", f"serial:{line.path}", "--baud", "115200", "--force"
        )
        board = await command("check", tmp_path / "daemon.toml")
    assert (rtu.code, serial.code, board.code) == (0, 0, 0)
    assert source == {
        "kind": "modbus-rtu",
        "port": bus.path,
        "baud": 19_200,
        "parity": "none",
        "unit": 7,
        "function": 3,
        "timeout_ms": 30_000,
    }
    assert json.loads(reads.out)["surfaces"]["bench"]["error"] is None


async def test_a_file_is_replaced_only_if_asked(tmp_path: Path) -> None:
    path = tmp_path / "daemon.toml"
    path.write_text("mine")
    refused = await init(tmp_path, "--source", "tcp://127.0.0.1")
    assert (refused.code, refused.complaint()) == (
        2,
        f"{path}: already exists; add --force to replace it, or name another file",
    )
    assert path.read_text() == "mine"
    model = ("--model-config", tmp_path / "built" / "bench.daemon.toml")
    forced = await command("init", path, *model, "--source", "tcp://127.0.0.1", "--force")
    assert forced.code == 0
    assert content(path)["surfaces"]["bench"]["source"]["port"] == 502


async def test_a_token_is_named_from_where_the_configuration_is_and_a_missing_one_is_said(tmp_path: Path) -> None:
    token = tmp_path / "secret" / "token"
    written = await init(tmp_path, "--source", "tcp://127.0.0.1", "--token-file", token)
    assert f"next: copy the service's token to {token}, so that this user can read it\n" in written.out
    assert Path(content(tmp_path / "daemon.toml")["publish"]["token_file"]) == Path("secret/token")


async def test_a_certificate_is_named_from_where_the_configuration_is(tmp_path: Path) -> None:
    options = ("--url", "https://beams.example:8420", "--certificate-file", tmp_path / "tls" / "plant.pem")
    written = await init(tmp_path, "--source", "tcp://127.0.0.1", *options)
    assert written.code == 0
    assert content(tmp_path / "daemon.toml")["publish"]["certificate_file"] == "tls/plant.pem"


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
async def test_comments_and_keys_in_any_spelling_stay_toml(tmp_path: Path, line_end: str) -> None:
    model = template(tmp_path)
    text = TEMPLATE.replace("# kept", "# kept\u2028and = this").replace("token_file =", '"token_file" =')
    model.write_bytes(text.replace("\n", line_end).encode())
    path = tmp_path / "daemon.toml"
    written = await command("init", path, "--model-config", model, "--source", "tcp://127.0.0.1", "--url", "http://b")
    assert written.code == 0, written.err
    assert content(path)["publish"] == {"url": "http://b", "token_file": "beamtouch.token", "batch_ms": 20}


def test_a_folder_that_is_closed_to_this_user_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with TemporaryDirectory() as name, without_root(Path(name)):
        path = Path(name) / "closed" / "deep" / "daemon.toml"
        path.parent.parent.mkdir(mode=0)
        code = main(["init", str(path)])
    assert (code, capsys.readouterr().err) == (2, f"beamtouch-daemon: {path}: Permission denied\n")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            (),
            "--source: give rtu:/dev/ttyUSB0, serial:/dev/ttyACM0 or tcp://HOST[:PORT]; beamtouch-daemon scan finds it",
        ),
        (("--source", "/dev/ttyUSB0"), "'/dev/ttyUSB0' is not a source; give rtu:/dev/ttyUSB0, "),
        (("--source", "tcp://"), "'tcp://' is not an address"),
        (("--source", "tcp://h", "--baud", "9600"), "--baud: a source such as tcp://h has none; leave it out"),
        (("--source", "serial:/dev/x", "--unit", "3"), "--unit: a source such as serial:/dev/x has none"),
        (("--source", "rtu:/dev/x", "--unit", "0"), "surfaces.bench.source.unit: must be at least 1"),
        (
            ("--source", "tcp://h", "--url", "beams"),
            'daemon.toml: publish.url: must look like http://127.0.0.1:8420 (given: "beams")',
        ),
    ],
)
async def test_what_is_wrong_is_one_line_and_nothing_is_written(
    tmp_path: Path, options: tuple[str, ...], said: str
) -> None:
    refused = await init(tmp_path, *options)
    assert refused.code == 2
    assert said in refused.complaint()
    assert not (tmp_path / "daemon.toml").exists()


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("bench.onnx", "", "the daemon reads no models; give what design-sensors build --daemon-config FILE wrote"),
        ("two.toml", TEMPLATE + configs.surface("two"), "has several surfaces"),
        ("bad.toml", TEMPLATE.replace("window", "windw"), "unknown key surfaces.bench.filter.windw"),
        (
            "inline.toml",
            TEMPLATE.replace('[surfaces."bench".source]\n', "").replace(
                configs.tcp(502), 'source = { kind = "modbus-tcp", host = "h" }'
            ),
            "has no table [surfaces.bench.source]",
        ),
    ],
)
async def test_a_file_that_is_no_configuration_of_a_model_is_refused(
    tmp_path: Path, name: str, text: str, said: str
) -> None:
    (tmp_path / name).write_text(text)
    refused = await command(
        "init", tmp_path / "daemon.toml", "--model-config", tmp_path / name, "--source", "tcp://127.0.0.1"
    )
    assert refused.code == 2
    assert refused.complaint().startswith(f"{tmp_path / name}: ")
    assert said in refused.complaint()
