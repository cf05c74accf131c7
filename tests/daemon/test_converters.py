"""Serial converters that pass bytes on over TCP: found, read, and named where Modbus TCP was expected."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from support.surfaces import configs

from .conftest import Refused
from .devices import NumberingUnit, RegisterUnit, RestingUnit, SerialDevice, rtu_units, with_crc
from .lines import SerialConverter, serial_converter
from .process import command, started
from .service import Service, serving
from .sessions import Reading, source_in, take_across_sessions
from .test_scan import is_configured

pytestmark = pytest.mark.anyio


def modbus_tcp_at(line: SerialConverter) -> str:
    """Return a source that takes a converter for a Modbus TCP device."""
    return configs.tcp(int(line.path.rpartition(":")[2])).replace("30_000", "500")


@pytest.mark.promise(
    "docs/how-to/adc-module.md",
    "if none answers, it asks in RTU frames, as through a serial converter.",
)
async def test_scan_finds_a_unit_behind_a_converter_and_its_command_configures_it(tmp_path: Path) -> None:
    async with serial_converter() as line, rtu_units(line, {1: RegisterUnit(8, 0), 3: RestingUnit()}):
        told = await command("scan", line.path, "--units", "1-3")
        as_json = await command("scan", line.path, "--units", "3", "--json")
        assert await is_configured(tmp_path, told)
    assert told.code == 0, told.err
    table, init = told.out.split("\n\n")
    assert [row.split(maxsplit=3) for row in table.splitlines()[1:]] == [
        ["1", "-", "-", "input"],
        ["3", "-", "-", "input, holding"],
    ]
    assert f"--source rtu:{line.path} --unit 1 --function 4 --timeout-ms 200\n" in init
    keys = {"kind": "modbus-rtu", "port": line.path, "timeout_ms": 200, "unit": 3, "function": 4}
    assert json.loads(as_json.out)["units"] == [{"source": keys, "registers": ["input", "holding"]}]


async def test_a_source_of_modbus_tcp_is_told_that_there_is_a_converter(tmp_path: Path) -> None:
    async with serial_converter() as line, rtu_units(line, {1: RestingUnit()}), serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=modbus_tcp_at(line)), url=service.url)
        checked = await command("check", config)
        async with started("run", config) as daemon:
            said = await daemon.said("trying again")
            assert (await daemon.stop()).code == 0
    address = line.path.removeprefix("tcp://")
    for text in (checked.complaint(), said):
        assert f"bench: {address} is a serial converter" in text
        assert f'write kind = "modbus-rtu" and port = "{line.path}" in its source' in text


async def test_a_converter_that_answers_any_bytes_in_rtu_frames_is_named_too(tmp_path: Path) -> None:
    async with serial_converter() as line:
        line.on_data(lambda _: line.write(with_crc(bytes.fromhex("01 04 04 4e20 4e20"))))
        checked = await command("check", configs.write(tmp_path, configs.surface(source=modbus_tcp_at(line))))
    assert "is a serial converter" in checked.complaint()


async def test_a_unit_behind_a_converter_is_read_and_again_after_its_connection_ended(tmp_path: Path) -> None:
    async with serial_converter() as line, rtu_units(line, {1: RestingUnit()}), serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=configs.rtu(line.path)), url=service.url)
        async with started("run", config) as daemon:
            await service.until(50)
            line.close()
            await service.until(len(service.samples()) + 50)
            outcome = await daemon.stop()
    assert outcome.code == 0
    assert line.connections == 2
    assert f"{line.path} is gone: " in outcome.err


async def test_no_late_answer_through_a_converter_is_taken_for_a_new_one() -> None:
    unit = NumberingUnit(lambda number, frame: [(0.3 if number % 7 == 0 else 0.0, frame)])
    async with serial_converter() as line, rtu_units(line, {1: unit}):
        source = source_in({}, f"{configs.rtu(line.path)}\ntimeout_ms = 200", ["register = 0", "register = 1"], 50.0)

        def check(reading: Reading) -> None:
            assert set(reading.counts) <= {unit.newest}

        await take_across_sessions(source, 60, check)


async def test_a_board_behind_a_converter_is_read(tmp_path: Path) -> None:
    async with serial_converter() as line:
        SerialDevice(line)
        checked = await command("check", configs.write(tmp_path, configs.surface(source=configs.serial(line.path))))
    assert checked.code == 0, checked


async def test_a_converter_that_is_away_or_does_not_resolve_is_named(tmp_path: Path) -> None:
    async with serial_converter() as line:
        path = line.path
    away = await command("check", configs.write(tmp_path, configs.surface(source=configs.rtu(path))))
    address = path.removeprefix("tcp://")
    assert away.complaint() == f"bench: no connection to {address}; is the device on, and is the address right?"
    source = configs.rtu("tcp://nowhere.invalid:4001")
    unknown = await command("check", configs.write(tmp_path, configs.surface(source=source)))
    assert "bench: nowhere.invalid does not resolve" in unknown.complaint()


@pytest.mark.parametrize("port", ["tcp://192.168.0.7", "udp://192.168.0.7:4001", "tcp://:4001", "tcp://a b:1"])
@pytest.mark.parametrize("source", [configs.rtu, configs.serial], ids=["rtu", "serial"])
def test_an_address_that_is_none_is_refused(
    port: str, source: Callable[[str], str], refused: Refused, tmp_path: Path
) -> None:
    said = refused("check", configs.write(tmp_path, configs.surface(source=source(port))))
    assert "give the path of a serial device, or tcp://HOST:PORT of a serial converter" in said


@pytest.mark.timeout(100)
async def test_a_line_that_babbles_between_answers_is_read_as_before() -> None:
    """Frames are looked for in a time that grows with the bytes; with their square, this takes an hour."""
    babble = np.random.default_rng(1).bytes(100_000)
    unit = NumberingUnit(lambda _number, frame: [(0.0, frame), (0.01, babble)])
    async with serial_converter() as line, rtu_units(line, {1: unit}):
        table = f'kind = "modbus-rtu"\nport = "{line.path}"\ntimeout_ms = 1000\nunit = 1'
        readings, errors = await take_across_sessions(source_in({}, table, ["register = 0"], 20.0), 3)
    assert len(readings) >= 3
    assert errors == []
