"""`scan` on real lines: pseudo-terminals, the board's protocol, and pymodbus's own servers."""

import asyncio
import json
import signal
from pathlib import Path

import pytest
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import DataType, SimData, SimDevice

from free_ports import free_port

from . import configs
from .devices import Pieces, SerialDevice, pymodbus_server, rtu_units
from .lines import joined_terminals, terminal
from .process import Outcome, command, started
from .register_units import RegisterUnit

pytestmark = pytest.mark.anyio

PATIENT = ("--timeout-ms", "30000")
"""For a starved machine; every unit that is asked exists."""


def last_line(outcome: Outcome) -> str:
    return outcome.err.splitlines()[-1].removeprefix("beamtouch-daemon: ")


def sources(outcome: Outcome) -> list[dict[str, object]]:
    """Return the sources in a report as JSON."""
    return [unit["source"] for unit in json.loads(outcome.out)["units"]]


def written(folder: Path, source: dict[str, object]) -> Path:
    """Write a configuration with a source as it was printed."""
    lines = "\n".join(f"{key} = {json.dumps(value)}" for key, value in source.items())
    return configs.write(folder, configs.surface(source=lines))


async def test_the_units_on_a_bus_are_found_with_their_registers_and_the_command_that_configures_them() -> None:
    with terminal() as bus:
        async with rtu_units(bus, {2: RegisterUnit(8, 0), 5: RegisterUnit(0, 3), 6: RegisterUnit(0, 0)}):
            told = await command("scan", bus.path, "--units", "2,5-6", "--baud", "9600", "--parity", "none", *PATIENT)
    assert told.code == 0, told.err
    table, init = told.out.split("\n\n")
    assert [line.split(maxsplit=3) for line in table.splitlines()] == [
        ["unit", "baud", "parity", "registers from 0"],
        ["2", "9600", "none", "input"],
        ["5", "9600", "none", "holding"],
        ["6", "9600", "none", "none: see its manual"],
    ]
    options = "--baud 9600 --parity none --unit 2 --function 4 --timeout-ms 30000"
    assert init == f"beamtouch-daemon init daemon.toml --model-config FILE --source rtu:{bus.path} {options}\n"


async def test_json_is_one_object_with_every_unit_and_the_source_that_reads_it(tmp_path: Path) -> None:
    with terminal() as bus:
        async with rtu_units(bus, {3: RegisterUnit(1, 125), 5: RegisterUnit(0, 8)}):
            told = await command("scan", bus.path, "--units", "3,5", "--baud", "19200", "--json", *PATIENT)
            checked = await command("check", written(tmp_path, sources(told)[1]), "--json")
    assert told.code == 0
    source = {
        "kind": "modbus-rtu",
        "port": bus.path,
        "baud": 19200,
        "parity": "none",
        "unit": 3,
        "function": 4,
        "timeout_ms": 30000,
    }
    assert json.loads(told.out) == {
        "target": bus.path,
        "units": [
            {"source": source, "registers": ["input", "holding"]},
            {"source": source | {"unit": 5, "function": 3}, "registers": ["holding"]},
        ],
        "board": None,
    }
    assert json.loads(checked.out)["surfaces"]["bench"]["error"] is None


async def test_a_scan_sends_only_requests_that_read_and_hellos() -> None:
    seen = bytearray()
    with terminal() as bus:
        bus.on_data(seen.extend)
        told = await command("scan", bus.path, "--units", "1-3", "--baud", "9600", "--parity", "none")
    assert told.code == 1
    assert last_line(told).startswith("nothing answers: check power, wiring")
    frames = bytes(seen[:48])
    assert [frames[at : at + 2] for at in range(0, 48, 8)] == [
        bytes([unit, function]) for unit in (1, 2, 3) for function in (4, 3)
    ]
    assert seen[48:]  # then the board is asked


async def test_a_board_is_found_and_its_source_reads_it(tmp_path: Path) -> None:
    with terminal() as line:
        SerialDevice(line)
        told = await command("scan", line.path, "--units", "1")
        as_json = await command("scan", line.path, "--units", "1", "--json")
        board = json.loads(as_json.out)["board"]
        checked = await command("check", written(tmp_path, board["source"]))
    assert told.code == as_json.code == checked.code == 0
    assert "a Beamtouch board at 1000000 baud: 2 channels, 16 ADC bits, at most 1000 readings per second" in told.out
    assert f"--source serial:{line.path} --baud 1000000\n" in told.out
    assert board["source"] == {"kind": "serial", "port": line.path, "baud": 1_000_000}
    assert (board["channel_count"], board["adc_bits"], board["max_rate_hz"]) == (2, 16, 1000)


async def test_units_of_a_server_that_is_not_ours_are_found_on_a_line() -> None:
    data = [SimData(0, values=[20_000] * 6, datatype=DataType.REGISTERS)]
    with joined_terminals() as (near, far):
        server = ModbusSerialServer(SimDevice(7, simdata=data), port=far, baudrate=19_200)
        await server.serve_forever(background=True)
        try:
            told = await command(
                "scan", near, "--units", "7", "--baud", "19200", "--parity", "none", "--json", *PATIENT
            )
        finally:
            await server.shutdown()  # type: ignore[no-untyped-call]  # pymodbus leaves it without annotations
    (unit,) = json.loads(told.out)["units"]
    assert (unit["source"]["unit"], unit["registers"]) == (7, ["input", "holding"])


async def test_units_behind_a_tcp_address_are_found_and_the_source_reads_them(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_000, 22_000]) as port:
        target = f"tcp://127.0.0.1:{port}"
        told = await command("scan", target, "--units", "1,2", *PATIENT)
        as_json = await command("scan", target, "--units", "1,2", "--json", *PATIENT)
        (source,) = sources(as_json)
        checked = await command("check", written(tmp_path, source))
    assert told.code == as_json.code == checked.code == 0
    rows = told.out.partition("\n\n")[0].splitlines()
    assert [row.split() for row in rows[1:]] == [["1", "-", "-", "input,", "holding"]]  # there is no unit 2
    assert f"--source {target} --unit 1 --function 4 --timeout-ms 30000" in told.out


async def test_an_address_without_a_device_and_a_port_in_use_fail_with_one_line() -> None:
    port = free_port()
    told = await command("scan", f"tcp://127.0.0.1:{port}")
    assert told.code == 1
    assert told.err.splitlines()[1:] == [
        f"beamtouch-daemon: no connection to 127.0.0.1:{port}; is the device on, and is the address right?"
    ]
    absent = await command("scan", "/dev/ttyNO")
    assert (absent.code, absent.complaint()) == (
        2,
        "/dev/ttyNO does not exist; plug the device in or correct the path",
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("/dev/null", "--units", "0-3"), "--units: a serial line has units 1 to 247"),
        (("/dev/null", "--units", "3-1"), "'3-1' is not a list of unit numbers from 0 to 255"),
        (("/dev/null", "--baud", "9600,9"), "'9600,9' is not a list of baud rates"),
        (("/dev/null", "--parity", "mark"), "'mark' is not a list of parities; choose of none,even,odd"),
        (("/dev/null", "--timeout-ms", "nan"), "'nan' is not a number of milliseconds from 1 to 60000"),
        (("tcp://127.0.0.1", "--baud", "9600"), "--baud and --parity are for a serial line"),
        (("udp://127.0.0.1",), "'udp://127.0.0.1' is not an address; give tcp://HOST[:PORT]"),
        (("tcp://127.0.0.1:99999",), "'tcp://127.0.0.1:99999' is not an address; give tcp://HOST[:PORT]"),
        (("tcp://plc..plant",), "'tcp://plc..plant' is not an address; give tcp://HOST[:PORT]"),
        ((f"tcp://{'plc' * 30}",), "is not an address; give tcp://HOST[:PORT]"),
        (("192.168.0.20",), "'192.168.0.20' is neither a serial port nor an address; give /dev/ttyUSB0,"),
        (("rtu:/dev/ttyUSB0",), "'rtu:/dev/ttyUSB0' is neither a serial port nor an address"),
    ],
)
async def test_wrong_arguments_are_one_line(words: tuple[str, ...], said: str) -> None:
    told = await command("scan", *words)
    assert (told.code, told.out) == (2, "")
    (line,) = told.err.splitlines()
    assert said in line


async def test_ctrl_c_ends_a_scan_with_130() -> None:
    asked = asyncio.Event()
    with terminal() as bus:
        bus.on_data(lambda _: asked.set())
        async with started("scan", bus.path, "--timeout-ms", "10000") as scan:
            await asyncio.wait_for(asked.wait(), 60)
            told = await scan.stop(signal.SIGINT)
    assert (told.code, told.out) == (130, "")
    assert last_line(told) == "interrupted"


async def test_a_line_that_is_unplugged_ends_the_scan() -> None:
    with terminal() as bus:
        bus.on_data(lambda _: bus.unplug())
        told = await command("scan", bus.path, "--timeout-ms", "10000")
    assert told.code == 1
    assert last_line(told) == f"{bus.path} is gone"


async def test_line_settings_that_the_port_refuses_are_not_called_silence() -> None:
    with terminal() as bus:
        told = await command("scan", bus.path, "--baud", "9600", "--parity", "even")
    assert told.code == 1
    assert last_line(told) == f"{bus.path} refuses these line settings, so no Modbus unit was asked; try others"


async def test_ctrl_c_prints_what_was_found_before() -> None:
    asked_next = asyncio.Event()

    def seen(request: bytes) -> Pieces:
        if request[0] == 3:
            asked_next.set()
        return []

    with terminal() as bus:
        async with (
            rtu_units(bus, {2: RegisterUnit(8, 0)}, echo=seen),
            started(
                "scan", bus.path, "--units", "2,3", "--baud", "9600", "--parity", "none", "--timeout-ms", "30000"
            ) as scan,
        ):
            await asyncio.wait_for(asked_next.wait(), 120)
            told = await scan.stop(signal.SIGINT)
    assert told.code == 130
    assert told.out.splitlines()[1].split() == ["2", "9600", "none", "input"]
    assert last_line(told) == "interrupted"


async def test_the_command_can_be_pasted_whatever_the_name_of_the_port(tmp_path: Path) -> None:
    with terminal() as bus:
        (tmp_path / "my port").symlink_to(bus.path)
        async with rtu_units(bus, {2: RegisterUnit(8, 0)}):
            told = await command("scan", str(tmp_path / "my port"), "--units", "2", "--baud", "9600", *PATIENT)
    assert f"--source 'rtu:{tmp_path}/my port' --baud" in told.out
