"""`scan`: finds the units on a Modbus bus or behind a Modbus TCP address, or the board on a serial line. Only reads."""

import argparse
import asyncio
import math
import sys
from collections.abc import Awaitable, Callable, Sequence
from contextlib import closing, suppress
from itertools import product
from pathlib import Path
from time import monotonic
from typing import get_args

from beamtouch_common.commands import DONE
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.argument_types import RTU_UNITS, address_of, ranges
from beamtouch_daemon.commands.scan_report import KINDS, Findings, FoundUnit, Source
from beamtouch_daemon.config.sources import ModbusTcp
from beamtouch_daemon.sources.board import BoardLine
from beamtouch_daemon.sources.host_address import HostAddress, no_connection
from beamtouch_daemon.sources.modbus_tcp import DEVICE_ITSELF, TcpLink
from beamtouch_daemon.sources.reading import NoAnswerError, SourceError
from beamtouch_daemon.sources.registers import Block, RegisterAnswer
from beamtouch_daemon.sources.requests import insist
from beamtouch_daemon.sources.rtu_frames import silence_of
from beamtouch_daemon.sources.rtu_line import RtuLine
from beamtouch_daemon.sources.serial_port import LineSettings, Opener, Parity, SerialPort

BAUDS = (9600, 19_200, 115_200, 38_400, 57_600)
"""The usual rates of Modbus modules, the most usual first."""
BOARD_BAUDS = (1_000_000,)
"""The rate of the boards in firmware_protocol."""
FIRST_UNITS = tuple(range(1, 17))
RTU_TIMEOUT_MS, TCP_TIMEOUT_MS = 100.0, 200.0
"""The defaults of the sources."""
CONNECT_S = 2.0
"""Shortest time limit of the first connection."""
PROGRESS_S = 5.0
"""Time between two lines of progress."""
ABSENT = (4, 10, 11)
"""Exceptions for a unit that is not there: of gateways (10, 11), and of servers with a fixed set of units (4)."""

Ask = Callable[[int, Block], Awaitable[RegisterAnswer]]
"""Asks a unit for registers; NoAnswerError if it does not answer."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError for wrong arguments, FailedError if nothing answers.

    Ctrl-C and a line that is unplugged end it with a report of what was found before.
    """
    scan = Scan(arguments)
    try:
        failure = asyncio.run(scan.network() if "://" in arguments.target else scan.line())
    except KeyboardInterrupt:  # enough was found
        scan.report(is_complete=False)
        raise
    except SourceError as error:
        scan.report(is_complete=False)
        raise FailedError(str(error)) from None
    scan.report(is_complete=True)
    if not scan.findings.has_any:
        raise FailedError(failure)
    return DONE


class Scan:
    """A scan, and what it has found."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.findings = Findings(arguments.target)
        self._arguments = arguments
        self._has_settings = False
        """True if the port has any of the line settings."""

    def report(self, *, is_complete: bool) -> None:
        """Print everything that has answered."""
        if self.findings.has_any or (is_complete and self._arguments.json):
            self.findings.print(as_json=self._arguments.json)

    async def network(self) -> str:
        """Ask the units behind an address; return what to check if none answers, SourceError without a connection.

        If none speaks Modbus TCP, they are asked as on a serial line, because there may be a converter at the address.
        """
        if self._arguments.baud is not None or self._arguments.parity is not None:
            raise InputError("--baud and --parity are for a serial line; leave them out with tcp://")
        target, (host, port) = self._arguments.target, address_of(self._arguments.target)
        units = self._arguments.units or (*FIRST_UNITS, *DEVICE_ITSELF)
        timeout_ms = self._arguments.timeout_ms or TCP_TIMEOUT_MS
        settings = ModbusTcp(kind="modbus-tcp", host=host, port=port, timeout_ms=timeout_ms)
        _say(f"{target}: Modbus TCP units {ranges(units)}; Ctrl-C ends it")
        try:
            async with asyncio.timeout(max(CONNECT_S, timeout_ms / 1e3)):
                _, writer = await asyncio.open_connection(host, port)
            writer.close()
        except OSError as error:  # also a timeout
            raise SourceError(no_connection(f"{host}:{port}")) from error

        async def ask(unit: int, block: Block) -> RegisterAnswer:
            link = TcpLink(settings, host, unit)
            async with link.opened():  # one connection at a time: some devices accept no more
                return await link.ask(block)

        timeout: Source = {"timeout_ms": math.ceil(timeout_ms)}
        await self._ask_units(target, {"kind": "modbus-tcp", "host": host, "port": port, **timeout}, units, ask)
        if not self.findings.has_any:
            source: Source = {"kind": "modbus-rtu", "port": f"tcp://{HostAddress(host, port)}", **timeout}
            with suppress(SourceError):  # a device that has no use for RTU frames may end the connection
                await self._ask_converter(f"{target} in RTU frames", source, units)
        more = f"try --units 1-247 or --timeout-ms {10 * timeout_ms:.0f}"  # a gateway waits in vain for absent units
        nothing = f"nothing answers: {target} accepts connections; check the unit numbers of the device, or {more}"
        return self.findings.failure(more) or nothing

    async def _ask_converter(self, name: str, source: Source, units: Sequence[int]) -> None:
        """Ask units in RTU frames over TCP; SourceError without a connection."""
        with closing(await Opener(str(source["port"]), LineSettings(BAUDS[0])).open()) as line:
            await self._ask_line(line, name, source, [unit for unit in units if unit in RTU_UNITS], 0.0)

    async def line(self) -> str:
        """Look for units and for a board; return what to check if nothing answers, SourceError without a port.

        The port is opened once, as that resets many devices. A board is looked for after the first line settings: its
        frames come only to a line on which no unit answered. It is waited for as long as a device may boot. Then the
        units are asked again that may have booted when they were asked.
        """
        path = self._arguments.target
        units = self._arguments.units or FIRST_UNITS
        _require_line(path, units)
        bauds, parities = self._arguments.baud or BAUDS, self._arguments.parity or get_args(Parity)
        first, *others = [LineSettings(baud, parity) for baud, parity in product(bauds, parities)]
        timeout_ms = self._arguments.timeout_ms or RTU_TIMEOUT_MS
        with closing(await Opener(path, LineSettings(BAUDS[0])).open()) as port:
            _say(f"{path}: Modbus RTU units {ranges(units)}, and a Beamtouch board; Ctrl-C ends it")
            try:
                booting = await self._ask_bus(port, first, timeout_ms, units)
                if not self.findings.units:
                    await self._look_for_board(port, self._arguments.baud or BOARD_BAUDS)
                if booting and not self.findings.board:
                    _say("again, because opening the port may have reset them:")
                    await self._ask_bus(port, first, timeout_ms, booting)
                for settings in others if not self.findings.board else ():
                    found = {unit.source["unit"] for unit in self.findings.units}
                    await self._ask_bus(port, settings, timeout_ms, [unit for unit in units if unit not in found])
            except SourceError as error:
                raise _line_error(path, error) from error
        if not self._has_settings:
            return f"{path} refuses these line settings, so no Modbus unit was asked; try others"
        more = f"try --units 1-247 or --timeout-ms {5 * timeout_ms:.0f}"
        wiring = "power, wiring (A and B swapped?) and the address of the device"
        return self.findings.failure(more) or f"nothing answers: check {wiring}, stop other masters, or {more}"

    async def _ask_bus(
        self, port: SerialPort, line: LineSettings, timeout_ms: float, units: Sequence[int]
    ) -> list[int]:
        """Ask units with these line settings, if the port has them; return those that may have booted meanwhile."""
        name = f"{line.baud} baud, parity {line.parity}"
        if not _has_changed(port, line, name):
            return []
        self._has_settings = True
        source: Source = {"kind": "modbus-rtu", "port": port.path, "baud": line.baud, "parity": line.parity}
        timeout: Source = {"timeout_ms": math.ceil(timeout_ms)}
        return await self._ask_line(port, name, source | timeout, units, silence_of(line.baud))

    async def _ask_line(
        self, port: SerialPort, name: str, source: Source, units: Sequence[int], silence_s: float
    ) -> list[int]:
        """Ask units in RTU frames; return those that did not answer and may have booted meanwhile."""
        line, booting = RtuLine(port, silence_s), list[int]()
        timeout_s = float(source["timeout_ms"]) / 1e3

        async def ask(unit: int, block: Block) -> RegisterAnswer:
            may_boot = uptime_s() < port.traffic.boots_until_s
            try:
                return await line.exchange(unit, block, timeout_s)
            except NoAnswerError:
                if may_boot and unit not in booting:
                    booting.append(unit)
                raise

        await self._ask_units(name, source, units, ask)
        self.findings.note(name, port.traffic)
        return booting

    async def _look_for_board(self, port: SerialPort, bauds: Sequence[int]) -> None:
        """Look for a device that speaks the protocol of `PROTOCOL.md`."""
        for baud in bauds:
            name = f"{baud} baud"
            if not _has_changed(port, LineSettings(baud), name):
                continue
            try:
                hello = await BoardLine(port).introduce()
            except SourceError:
                if port.failure:
                    raise
                _say(f"{name}: no Beamtouch board")
                self.findings.note(name, port.traffic)
            else:
                self.findings.board = {"kind": "serial", "port": port.path, "baud": baud}, hello
                _say(f"{name}: a Beamtouch board")
                return

    async def _ask_units(self, name: str, source: Source, units: Sequence[int], ask: Ask) -> None:
        """Ask units one after the other for the first register of each kind, and say which of them answer."""
        said_s, before = monotonic(), len(self.findings.units)
        for number, unit in enumerate(units, 1):
            answers = await _ask_unit(unit, ask)
            if answers:
                functions = [function for function, answer in answers.items() if not answer.exception]
                refusals = sorted({code for answer in answers.values() for code in answer.refusals})
                # Input registers hold what a unit measures, holding registers often its settings.
                keys: Source = {"unit": unit, "function": [*functions, 4][0]}
                self.findings.units.append(FoundUnit(source | keys, functions, refusals))
                _say(f"{name}: unit {unit} answers")
            elif monotonic() - said_s >= PROGRESS_S:
                said_s = monotonic()
                _say(f"{name}: {number} of {len(units)} units asked, the last is {unit}")
        if len(self.findings.units) == before:
            _say(f"{name}: nothing")


async def _ask_unit(unit: int, ask: Ask) -> dict[int, RegisterAnswer]:
    """Return the answers of a unit, by function; none if there is no such unit.

    A unit that answers one request and not another is asked again, because it may be busy now and then.
    """
    answers: dict[int, RegisterAnswer] = {}
    for function in KINDS:
        with suppress(NoAnswerError):
            answers[function] = await ask(unit, Block(0, 1, function))
    if all(answer.exception in ABSENT for answer in answers.values()):
        return {}
    for function in KINDS:
        first = answers.get(function)
        if first is None or first.may_pass:
            with suppress(NoAnswerError):
                again = await insist(lambda block: ask(unit, block), Block(0, 1, function))
                refusals = (first.exception, *again.refusals) if first else again.refusals
                answers[function] = again._replace(refusals=refusals)
    return answers


def _require_line(path: str, units: Sequence[int]) -> None:
    """Raise InputError if this is no serial port, or if a line has no such units."""
    message = ""
    if not Path(path).exists():
        message = f"{path!r} is neither a serial port nor an address; give /dev/ttyUSB0, for example, or tcp://HOST"
        if path.startswith(("/", ".")):
            message = f"{path} does not exist; plug the device in or correct the path"
    elif not set(units) <= set(RTU_UNITS):
        message = "--units: a serial line has units 1 to 247"
    if message:
        raise InputError(message)


def _line_error(path: str, error: SourceError) -> SourceError:
    return error if Path(path).exists() else SourceError(f"{path} is gone")


def _has_changed(port: SerialPort, line: LineSettings, name: str) -> bool:
    """Change the settings of a line; if the port does not have them, say so and return False."""
    try:
        port.change(line)
    except SourceError as error:
        _say(f"{name}: {error}")
        return False
    return True


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
