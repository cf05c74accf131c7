"""`init`: what it writes from options, and what it refuses."""

import json
import stat
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from beamtouch_daemon.cli import main
from support.programs.in_process import Outcome, command_of
from support.surfaces import configs

from .conftest import Refused
from .devices import SerialDevice, StampingUnit, pymodbus_server, rtu_units
from .lines import terminal
from .process import command

TEMPLATE = (
    """\
# Acquisition of the surface "bench".
"""
    + configs.PUBLISH.replace("batch_ms", "# kept\nbatch_ms")
    + configs.surface('"bench"').replace('name = "s1"', 'name = "s1"     # mounted 35 mm from the left end')
)
TCP = ("--source", "tcp://127.0.0.1")
Init = Callable[..., Outcome]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """Return what `design-sensors build --daemon-config` writes, in a folder of its own, and a token for the result."""
    (tmp_path / "built").mkdir()
    path = tmp_path / "built" / "bench.daemon.toml"
    path.write_text(TEMPLATE)
    (tmp_path / "beamtouch.token").write_text("swordfish-of-the-tests")
    return path


@pytest.fixture
def init(tmp_path: Path, model: Path, capsys: pytest.CaptureFixture[str]) -> Init:
    """A function from options to the outcome of the command, which writes `daemon.toml`."""
    run = command_of(main, capsys)
    return lambda *options: run("init", tmp_path / "daemon.toml", "--model-config", model, *options)


def content(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "daemon.toml").read_text())


@pytest.mark.promise(
    "docs/how-to/adc-module.md",
    "`init` takes everything about the surface from the model's configuration, and adds the source",
)
def test_a_configuration_has_the_source_and_the_service_and_keeps_what_belongs_to_the_model(
    tmp_path: Path, init: Init
) -> None:
    source = "tcp://192.168.0.20:5020"
    options = ("--unit", "1", "--timeout-ms", "30000", "--url", "https://beams.example:8420/")
    written = init("--source", source, *options)
    path = tmp_path / "daemon.toml"
    assert (written.returncode, written.stderr) == (0, "")
    assert written.stdout.startswith(f"{path}: bench, channels s1, s2, 200 readings per second from {source}\n")
    assert f"next: beamtouch-daemon check {path} --wait 30\n" in written.stdout
    told, known = content(tmp_path), tomllib.loads(TEMPLATE)
    keys = {"kind": "modbus-tcp", "host": "192.168.0.20", "port": 5020, "unit": 1, "timeout_ms": 30_000}
    assert told["surfaces"]["bench"].pop("source") == keys
    known["surfaces"]["bench"].pop("source")
    assert told["surfaces"] == known["surfaces"]
    assert told["publish"] == {"url": "https://beams.example:8420", "token_file": "beamtouch.token", "batch_ms": 20}
    assert "# mounted 35 mm from the left end" in path.read_text()
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


@pytest.mark.promise(
    "docs/how-to/adc-module.md",
    "It takes the channels to be whole numbers of 16 bits (`u16`) on the registers 0, 1, 2 and so on.",
)
@pytest.mark.parametrize(
    ("options", "registers", "value_type"),
    [
        (("--type", "f32"), [0, 2], "f32"),
        (("--type", "f64", "--register", "100"), [100, 104], "f64"),
        (("--register", "7"), [7, 8], None),
        (("--type", "i16"), [0, 1], "i16"),
    ],
)
def test_values_of_another_type_follow_each_other_from_a_register_on(
    tmp_path: Path, model: Path, init: Init, options: tuple[str, ...], registers: list[int], value_type: str | None
) -> None:
    model.write_text(TEMPLATE.replace("range_mm", "adc_bits = 12\nrange_mm"))
    written = init(*TCP, "--byte-order", "CDAB", *options)
    assert (written.returncode, written.stderr) == (0, "")
    bench = content(tmp_path)["surfaces"]["bench"]
    assert [(one["register"], one.get("type")) for one in bench["channels"]] == [(at, value_type) for at in registers]
    assert bench["source"]["byte_order"] == "CDAB"
    bits = {one.get("adc_bits") for one in bench["channels"]}
    assert bits == ({None} if value_type in ("f32", "f64") else {12})  # a fractional number has none
    assert ("; for values in mm they are 1 and 0" in written.stdout) == (value_type in ("f32", "f64"))
    assert "# mounted 35 mm from the left end" in (tmp_path / "daemon.toml").read_text()


@pytest.mark.parametrize("types", [("f32", "f32"), ("u16", "f64"), ("f64", "u16")])
def test_values_of_the_models_types_follow_each_other_from_a_register_on(
    tmp_path: Path, model: Path, init: Init, types: tuple[str, str]
) -> None:
    first, second = types
    text = configs.PUBLISH + configs.surface(registers=(0, 4)).replace('name = "s1"', f'name = "s1"\ntype = "{first}"')
    model.write_text(text.replace('name = "s2"', f'name = "s2"\ntype = "{second}"'))
    written = init(*TCP, "--register", "10")
    assert (written.returncode, written.stderr) == (0, "")
    channels = content(tmp_path)["surfaces"]["bench"]["channels"]
    after = 10 + {"u16": 1, "f32": 2, "f64": 4}[first]
    assert [(one["register"], one["type"]) for one in channels] == [(10, first), (after, second)]


@pytest.mark.anyio
async def test_configurations_for_tcp_for_a_bus_and_for_a_board_pass_check(tmp_path: Path, model: Path) -> None:
    reads = []
    with terminal() as bus, terminal() as line:
        SerialDevice(line)
        async with rtu_units(bus, {7: StampingUnit()}), pymodbus_server([20_000, 21_000]) as port:
            sources: list[list[str]] = [
                [f"tcp://127.0.0.1:{port}", "--timeout-ms", "30000"],
                [f"rtu:{bus.path}", "--baud", "19200", "--unit", "7", "--function", "3", "--timeout-ms", "30000"],
                [f"serial:{line.path}", "--baud", "115200"],
            ]
            for source, *options in sources:
                config = tmp_path / "daemon.toml"
                words: list[str | Path] = ["--model-config", model, "--source", source, *options, "--force"]
                assert (await command("init", config, *words)).code == 0
                reads.append(json.loads((await command("check", config, "--json")).out)["surfaces"]["bench"]["error"])
    assert reads == [None] * 3


def test_a_file_is_replaced_only_if_asked(tmp_path: Path, init: Init) -> None:
    path = tmp_path / "daemon.toml"
    path.write_text("mine")
    refused = init(*TCP)
    said = f"beamtouch-daemon: {path}: already exists; add --force to replace it, or name another file\n"
    assert (refused.returncode, refused.stderr) == (2, said)
    assert path.read_text() == "mine"
    assert init(*TCP, "--force").returncode == 0
    assert content(tmp_path)["surfaces"]["bench"]["source"]["port"] == 502


def test_token_and_certificate_are_named_from_where_the_configuration_is(tmp_path: Path, init: Init) -> None:
    token = tmp_path / "secret" / "token"
    written = init(*TCP, "--token-file", token, "--certificate-file", tmp_path / "tls" / "plant.pem")
    assert f"next: copy the service's token to {token}, so that this user can read it\n" in written.stdout
    publish = content(tmp_path)["publish"]
    assert (publish["token_file"], publish["certificate_file"]) == ("secret/token", "tls/plant.pem")


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_comments_and_keys_in_any_spelling_stay_toml(tmp_path: Path, model: Path, init: Init, line_end: str) -> None:
    text = TEMPLATE.replace("# kept", "# kept\u2028and = this").replace("token_file =", '"token_file" =')
    model.write_bytes(text.replace("\n", line_end).encode())
    assert init(*TCP, "--url", "http://b").returncode == 0
    assert content(tmp_path)["publish"] == {"url": "http://b", "token_file": "beamtouch.token", "batch_ms": 20}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "--source: give rtu:/dev/ttyUSB0, serial:/dev/ttyACM0 or tcp://HOST[:PORT]; beamtouch-daemon scan finds"),
        (("--source", "/dev/ttyUSB0"), "'/dev/ttyUSB0' is not a source; give rtu:/dev/ttyUSB0, "),
        (("--source", "tcp://h", "--baud", "9600"), "--baud: a source such as tcp://h has none; leave it out"),
        (
            ("--source", "serial:/dev/x", "--type", "f32"),
            "--type: a source such as serial:/dev/x has none",
        ),
        (("--source", "rtu:/dev/x", "--unit", "0"), "surfaces.bench.source.unit: must be at least 1"),
        (("--source", "rtu:/dev/tty\udcff"), "the source and the files must have names in UTF-8"),
    ],
)
def test_what_is_wrong_is_one_line_and_nothing_is_written(
    tmp_path: Path, model: Path, refused: Refused, options: tuple[str, ...], said: str
) -> None:
    assert said in refused("init", tmp_path / "daemon.toml", "--model-config", model, *options)
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
def test_a_file_that_is_no_configuration_of_a_model_is_refused(
    tmp_path: Path, refused: Refused, name: str, text: str, said: str
) -> None:
    (tmp_path / name).write_text(text)
    told = refused("init", tmp_path / "daemon.toml", "--model-config", tmp_path / name, *TCP)
    assert told.startswith(f"{tmp_path / name}: {said}")
