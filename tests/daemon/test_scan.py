"""`scan` on real lines: pseudo-terminals, the board's protocol, and pymodbus's own servers."""

import asyncio
import json
import shlex
import signal
from pathlib import Path

import pytest

from support.network.free_ports import free_port
from support.surfaces import configs

from .conftest import Refused
from .devices import Pieces, RegisterUnit, SerialDevice, pymodbus_server, rtu_units
from .lines import terminal
from .process import Outcome, command, started
from .service import TOKEN

pytestmark = pytest.mark.anyio

PATIENT = ("--timeout-ms", "30000")
"""For a starved machine; every unit that is asked exists."""
SLOW = ("--baud", "9600", "--parity", "none")
SHORT = "from beamtouch_daemon.sources import board, traffic; traffic.BOOT_S = board.HELLO_TIMEOUT_S = 0.5"
"""Code by which a board is waited for briefly."""


def last_line(outcome: Outcome) -> str:
    return outcome.err.splitlines()[-1].removeprefix("beamtouch-daemon: ")


async def is_configured(folder: Path, told: Outcome) -> bool:
    """Return whether `check` reads what the printed command of `init` configures."""
    config = folder / "daemon.toml"
    (folder / "beamtouch.token").write_text(TOKEN)
    (folder / "built.toml").write_text(configs.PUBLISH + configs.surface())
    (line,) = [line for line in told.out.splitlines() if line.startswith("beamtouch-daemon init daemon.toml ")]
    given = line.replace(" daemon.toml ", f" {config} --force ").replace(" FILE ", f" {folder}/built.toml ")
    written = await command(*shlex.split(given)[1:])
    assert written.code == 0, written.err
    checked = await command("check", config, "--json")
    return json.loads(checked.out)["surfaces"]["bench"]["error"] is None


@pytest.mark.promise(
    "docs/how-to/adc-module.md",
    "If a unit has input and holding registers, the command names the input registers (function 4).",
)
async def test_the_units_on_a_bus_are_found_with_their_registers_and_the_command_that_configures_them(
    tmp_path: Path,
) -> None:
    with terminal() as bus:
        port = tmp_path / "my port"
        port.symlink_to(bus.path)
        async with rtu_units(bus, {2: RegisterUnit(8, 0), 5: RegisterUnit(0, 8), 6: RegisterUnit(0, 0)}):
            told = await command("scan", port, "--units", "2,5-6", *SLOW, *PATIENT)
            as_json = await command("scan", port, "--units", "2,5", *SLOW, *PATIENT, "--json")
            assert await is_configured(tmp_path, told)
    assert told.code == 0, told.err
    table, init = told.out.split("\n\n")
    assert [line.split(maxsplit=3) for line in table.splitlines()] == [
        ["unit", "baud", "parity", "registers from 0"],
        ["2", "9600", "none", "input"],
        ["5", "9600", "none", "holding"],
        ["6", "9600", "none", "none: see its manual"],
    ]
    options = "--baud 9600 --parity none --unit 2 --function 4 --timeout-ms 30000"
    # It can be pasted, whatever the name of the port.
    assert init == f"beamtouch-daemon init daemon.toml --model-config FILE --source 'rtu:{port}' {options}\n"
    keys = {"kind": "modbus-rtu", "port": str(port), "baud": 9600, "parity": "none", "timeout_ms": 30_000}
    assert json.loads(as_json.out)["units"] == [
        {"source": keys | {"unit": 2, "function": 4}, "registers": ["input"]},
        {"source": keys | {"unit": 5, "function": 3}, "registers": ["holding"]},
    ]


@pytest.mark.promise(
    "docs/how-to/adc-module.md",
    "It only reads registers (functions 3 and 4), so it changes no device.",
)
async def test_a_scan_sends_only_requests_that_read_and_hellos() -> None:
    seen = bytearray()
    with terminal() as bus:
        bus.on_data(seen.extend)
        told = await command("scan", bus.path, "--units", "1-3", *SLOW, code=SHORT)
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
        assert as_json.code == 0, as_json.err
        assert await is_configured(tmp_path, told)
    assert "a Beamtouch board at 1000000 baud: 2 channels, 16 ADC bits, at most 1000 readings per second" in told.out
    assert f"--source serial:{line.path} --baud 1000000\n" in told.out
    board = json.loads(as_json.out)["board"]
    assert (board["channel_count"], board["adc_bits"], board["max_rate_hz"]) == (2, 16, 1000)


async def test_a_unit_of_a_server_that_is_not_ours_is_found_behind_an_address(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_000, 22_000]) as port:
        target = f"tcp://127.0.0.1:{port}"
        told = await command("scan", target, "--units", "1,2", *PATIENT)
        assert await is_configured(tmp_path, told)
    table, _ = told.out.split("\n\n")
    assert [row.split() for row in table.splitlines()[1:]] == [["1", "-", "-", "input,", "holding"]]  # there is no 2
    assert f"--source {target} --unit 1 --function 4 --timeout-ms 30000" in told.out


async def test_what_cannot_be_asked_is_not_called_silence() -> None:
    port = free_port()
    absent = await command("scan", f"tcp://127.0.0.1:{port}")
    assert (absent.code, last_line(absent)) == (
        1,
        f"no connection to 127.0.0.1:{port}; is the device on, and is the address right?",
    )
    with terminal() as bus:
        refused = await command("scan", bus.path, "--baud", "9600", "--parity", "even")
        assert (refused.code, last_line(refused)) == (
            1,
            f"{bus.path} refuses these line settings, so no Modbus unit was asked; try others",
        )
    with terminal() as bus:
        bus.on_data(lambda _: bus.unplug())
        unplugged = await command("scan", bus.path, "--timeout-ms", "10000")
    assert (unplugged.code, last_line(unplugged)) == (1, f"{bus.path} is gone")


async def test_settings_that_the_port_refuses_leave_the_others_to_be_tried() -> None:
    with terminal() as bus:
        async with rtu_units(bus, {2: RegisterUnit(8, 0)}):
            options = ("--units", "2", "--baud", "9600,19200", "--parity", "even,none", "--timeout-ms", "2000")
            told = await command("scan", bus.path, *options, "--json", code=SHORT)
    (found,) = json.loads(told.out)["units"]
    assert (found["source"]["baud"], found["source"]["parity"]) == (9600, "none")
    assert f"9600 baud, parity even: {bus.path} refuses these settings: Invalid argument" in told.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("/dev/null", "--units", "0-3"), "--units: a serial line has units 1 to 247"),
        (("/dev/null", "--units", "3-1"), "'3-1' is not a list of unit numbers from 0 to 255"),
        (("/dev/ttyNO",), "/dev/ttyNO does not exist; plug the device in or correct the path"),
        (("tcp://127.0.0.1", "--baud", "9600"), "--baud and --parity are for a serial line"),
        (("udp://127.0.0.1",), "'udp://127.0.0.1' is not an address; give tcp://HOST[:PORT]"),
        (("192.168.0.20",), "'192.168.0.20' is neither a serial port nor an address; give /dev/ttyUSB0,"),
    ],
)
def test_wrong_arguments_are_one_line(refused: Refused, words: tuple[str, ...], said: str) -> None:
    assert said in refused("scan", *words)


@pytest.mark.promise("docs/how-to/adc-module.md", "Ctrl-C ends the scan and prints what was found so far.")
async def test_ctrl_c_ends_a_scan_with_130_and_what_was_found_before() -> None:
    asked_next = asyncio.Event()

    def seen(request: bytes) -> Pieces:
        if request[0] == 3:
            asked_next.set()
        return []

    with terminal() as bus:
        async with (
            rtu_units(bus, {2: RegisterUnit(8, 0)}, echo=seen),
            started("scan", bus.path, "--units", "2,3", *SLOW, *PATIENT) as scan,
        ):
            await asyncio.wait_for(asked_next.wait(), 120)
            told = await scan.stop(signal.SIGINT)
    assert told.code == 130
    assert told.out.splitlines()[1].split() == ["2", "9600", "none", "input"]
    assert last_line(told) == "interrupted"
