"""`scan` on lines in trouble: late, lossy and talkative ones, settings that a port refuses, and Ctrl-C halfway."""

import asyncio
import json
import signal
from collections.abc import Callable

import pytest

from beamtouch_daemon.commands.scan_plan import LinePlan, NetworkPlan
from beamtouch_daemon.commands.scan_text import lines
from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources.scanned_unit import FoundUnit

from .devices import Pieces, rtu_units
from .lines import terminal
from .process import Outcome, command, started
from .register_units import RegisterUnit

pytestmark = pytest.mark.anyio

ONE_SETTING = ("--baud", "9600", "--parity", "none")
LATE_S = 3.0


class LosingUnit(RegisterUnit):
    """A unit of which one answer is lost: the first to a request for several registers."""

    def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
        pieces = super().answer(request, wrap)
        return [] if self.requests == 2 else pieces


class LateUnit(RegisterUnit):
    """A unit that takes its time."""

    def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
        return [(LATE_S, frame) for _, frame in super().answer(request, wrap)]


def last_line(outcome: Outcome) -> str:
    return outcome.err.splitlines()[-1].removeprefix("beamtouch-daemon: ")


async def test_a_lost_answer_hides_no_registers() -> None:
    with terminal() as bus:
        async with rtu_units(bus, {2: LosingUnit(8, 0)}):
            told = await command("scan", bus.path, "--units", "2", *ONE_SETTING, "--timeout-ms", "3000", "--json")
    (unit,) = json.loads(told.out)["units"]
    assert (unit["input_registers"], unit["holding_registers"]) == (8, 0)


async def test_a_unit_that_answers_too_late_is_named() -> None:
    with terminal() as bus:
        async with rtu_units(bus, {2: LateUnit(8, 0)}):
            told = await command("scan", bus.path, "--units", "2", *ONE_SETTING, "--timeout-ms", "2000")
    assert (told.code, told.out) == (1, "")
    assert last_line(told) == "nothing answers in time; unit 2 answers later than 2000 ms: add --timeout-ms 10000"


async def test_a_line_that_talks_is_said() -> None:
    with terminal() as bus:
        bus.on_data(lambda _: bus.write(b"weight 12.5 kg\r\n" * 300))
        told = await command("scan", bus.path, "--units", "1-3", *ONE_SETTING, "--timeout-ms", "20")
    assert told.code == 1
    assert " bytes came, but no answers: another master, another program or a device that talks" in last_line(told)


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
            started("scan", bus.path, "--units", "2,3", *ONE_SETTING, "--timeout-ms", "30000") as scan,
        ):
            await asyncio.wait_for(asked_next.wait(), 120)
            told = await scan.stop(signal.SIGINT)
    assert told.code == 130
    assert told.out.splitlines()[1].split() == ["2", "9600", "none", "0-7", "none", "from", "0"]
    assert last_line(told) == "interrupted"


def reported(plan: LinePlan | NetworkPlan, *units: FoundUnit) -> str:
    return "\n".join(lines(plan, units, None))


def line_plan(path: str, timeout_ms: float) -> LinePlan:
    settings = ModbusRtu(kind="modbus-rtu", port=path, baud=9600, timeout_ms=timeout_ms)
    return LinePlan(path, (9600,), (settings,), (2,))


@pytest.mark.parametrize(("line_ms", "tcp_ms", "stated"), [(100.0, 200.0, False), (200.0, 100.0, True)])
def test_the_command_states_every_timeout_that_init_would_not_take_by_itself(
    line_ms: float, tcp_ms: float, stated: bool
) -> None:
    on_line = reported(line_plan("/dev/ttyUSB0", line_ms), FoundUnit(2, {4: 8, 3: 0}, 9600, "none"))
    over_tcp = reported(NetworkPlan("plc", 502, (2,), tcp_ms), FoundUnit(2, {4: 8, 3: 0}))
    assert (f"--function 4 --timeout-ms {line_ms:g}" in on_line) is stated
    assert (f"--function 4 --timeout-ms {tcp_ms:g}" in over_tcp) is stated


def test_the_command_can_be_pasted_whatever_the_name_of_the_port() -> None:
    text = reported(line_plan("/dev/my port", 100.0), FoundUnit(2, {4: 8, 3: 0}, 9600, "none"))
    assert "--source 'rtu:/dev/my port' --baud" in text


def test_input_registers_go_before_settings_in_holding_registers() -> None:
    text = reported(NetworkPlan("plc", 502, (1,), 200.0), FoundUnit(1, {4: 8, 3: 120}))
    assert "[surfaces.NAME.source]    # or function = 3: its manual says where the inputs are\n" in text
    assert "function = 4" in text


def test_a_device_that_answers_as_every_unit_is_one_device() -> None:
    units = [FoundUnit(unit, {4: 8, 3: 0}) for unit in (1, 2, 0, 255)]
    text = reported(NetworkPlan("plc", 502, (1, 2, 0, 255), 200.0), *units)
    assert "# it answers as every unit, so it is probably one device\n" in text
