"""`scan`: finds the units on a Modbus bus or behind a Modbus TCP address, or the board on a serial line. Only reads."""

import argparse
import asyncio
import json
import math
import shlex
import sys
from collections.abc import Awaitable, Callable, Sequence
from contextlib import closing, suppress
from dataclasses import asdict
from itertools import product
from pathlib import Path
from time import monotonic
from typing import get_args

from beamtouch_common.commands import DONE
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.table import aligned
from beamtouch_daemon.commands.argument_types import RTU_UNITS, address_of, ranges
from beamtouch_daemon.config.sources import ModbusRtu, ModbusTcp
from beamtouch_daemon.sources.board import BoardPort
from beamtouch_daemon.sources.modbus_tcp import DEVICE_ITSELF, TcpLink
from beamtouch_daemon.sources.reading import NoAnswerError, SourceError
from beamtouch_daemon.sources.registers import Answer, Block
from beamtouch_daemon.sources.rtu_bus import RtuBus, RtuLink
from beamtouch_daemon.sources.serial_port import Parity, SerialPort
from beamtouch_protocol.messages import Hello

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
KINDS = {4: "input", 3: "holding"}
"""Registers by the function that reads them; reading them changes no device."""
ABSENT = (4, 10, 11)
"""Exceptions for a unit that is not there: of gateways (10, 11), and of servers with a fixed set of units (4)."""

Source = dict[str, str | float]
"""Keys of a `[source]` table."""


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
    if not scan.has_found:
        raise FailedError(failure)
    return DONE


class Scan:
    """A scan and everything that has answered."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._arguments = arguments
        self._units: list[tuple[Source, list[int]]] = []
        """The source that reads a unit, and the functions that give its register 0."""
        self._board: tuple[Source, Hello] | None = None

    @property
    def has_found(self) -> bool:
        """Whether anything has answered."""
        return bool(self._units or self._board)

    async def network(self) -> str:
        """Ask the units behind an address; return what to check if none answers, SourceError without a connection."""
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
            raise SourceError(f"no connection to {host}:{port}; is the device on, and is the address right?") from error

        async def ask(unit: int, block: Block) -> Answer:
            link = TcpLink(settings, host, unit)
            async with link.opened():  # one connection at a time: some devices accept no more
                return await link.read(block)

        source: Source = {"kind": "modbus-tcp", "host": host, "port": port, "timeout_ms": math.ceil(timeout_ms)}
        await self._ask_units(target, source, units, ask)
        more = f"try --units 1-247 or --timeout-ms {10 * timeout_ms:.0f}"  # a gateway waits in vain for absent units
        return f"nothing answers: {target} accepts connections; check the unit numbers of the device, or {more}"

    async def line(self) -> str:
        """Look for units and for a board; return what to check if nothing answers, SourceError without a port.

        A board is looked for after the first line settings: its frames come only to a line on which no unit answered.
        """
        path = self._arguments.target
        units = self._arguments.units or FIRST_UNITS
        _require_line(path, units)
        settings = list(product(self._arguments.baud or BAUDS, self._arguments.parity or get_args(Parity)))
        board_bauds = self._arguments.baud or BOARD_BAUDS
        timeout_ms = self._arguments.timeout_ms or RTU_TIMEOUT_MS
        SerialPort(path, BAUDS[0]).close()  # whether it can be opened does not depend on the settings to try
        _say(f"{path}: Modbus RTU units {ranges(units)}, and a Beamtouch board; Ctrl-C ends it")
        is_refused = True
        for place, (baud, parity) in enumerate(settings):
            absent = [unit for unit in units if unit not in {source["unit"] for source, _ in self._units}]
            try:
                await self._bus(path, baud, parity, timeout_ms, absent)
                is_refused = False
            except SourceError as error:
                _require_port(path, f"{baud} baud, parity {parity}", error)
            if place == 0 and not self._units:
                await self._look_for_board(path, board_bauds)
            if self._board is not None:
                break
        if is_refused:
            return f"{path} refuses these line settings, so no Modbus unit was asked; try others"
        more = f"try --units 1-247 or --timeout-ms {5 * timeout_ms:.0f}"
        wiring = "power, wiring (A and B swapped?) and the address of the device"
        return f"nothing answers: check {wiring}, stop other masters, or {more}"

    async def _bus(self, path: str, baud: int, parity: Parity, timeout_ms: float, units: Sequence[int]) -> None:
        """Ask units with these line settings; SourceError if the port does not have them, or is gone."""
        bus = RtuBus(ModbusRtu(kind="modbus-rtu", port=path, baud=baud, parity=parity))
        source: Source = {"kind": "modbus-rtu", "port": path, "baud": baud, "parity": parity}

        async def ask(unit: int, block: Block) -> Answer:
            link = RtuLink(bus, unit, [block], timeout_ms / 1e3)
            async with link.opened():
                return await link.ask(block)

        async with bus.used():
            timeout: Source = {"timeout_ms": math.ceil(timeout_ms)}
            await self._ask_units(f"{baud} baud, parity {parity}", source | timeout, units, ask)

    async def _look_for_board(self, path: str, bauds: Sequence[int]) -> None:
        """Look for a device that speaks the protocol of `PROTOCOL.md`; SourceError if the port is gone."""
        for baud in bauds:
            try:
                with closing(BoardPort(path, baud)) as port:
                    self._board = {"kind": "serial", "port": path, "baud": baud}, await port.introduce()
            except SourceError as error:
                _require_port(path, f"{baud} baud", error)
            else:
                _say(f"{baud} baud: a Beamtouch board")
                return

    async def _ask_units(
        self, name: str, source: Source, units: Sequence[int], ask: Callable[[int, Block], Awaitable[Answer]]
    ) -> None:
        """Ask units one after the other for the first register of each kind, and say which of them answer."""
        said_s, before = monotonic(), len(self._units)
        for number, unit in enumerate(units, 1):
            exceptions: dict[int, int] = {}
            for function in KINDS:
                with suppress(NoAnswerError):
                    exceptions[function] = (await ask(unit, Block(0, 1, function))).exception
            if set(exceptions.values()) - set(ABSENT):
                _say(f"{name}: unit {unit} answers")
                functions = [function for function, exception in exceptions.items() if not exception]
                # Input registers hold what a unit measures, holding registers often its settings.
                self._units.append((source | {"unit": unit, "function": [*functions, 4][0]}, functions))
            elif monotonic() - said_s >= PROGRESS_S:
                said_s = monotonic()
                _say(f"{name}: {number} of {len(units)} units asked, the last is {unit}")
        if len(self._units) == before:
            _say(f"{name}: nothing")

    def report(self, *, is_complete: bool) -> None:
        """Print everything that has answered."""
        if self._arguments.json:
            if is_complete or self.has_found:
                board = None if self._board is None else {"source": self._board[0], **asdict(self._board[1])}
                units = [
                    {"source": source, "registers": [KINDS[function] for function in functions]}
                    for source, functions in self._units
                ]
                print(json.dumps({"target": self._arguments.target, "units": units, "board": board}))
            return
        if self._board is not None:
            source, hello = self._board
            print(f"a Beamtouch board at {source['baud']} baud: {_describe(hello)}\n\n{_init_command(source)}")
        if self._units:
            head = ("unit", "baud", "parity", "registers from 0")
            print("\n".join(aligned(head, [_row(source, functions) for source, functions in self._units])))
            print(f"\n{_init_command(self._units[0][0])}")


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


def _require_port(path: str, name: str, error: SourceError) -> None:
    """Say what failed, such as line settings that the port does not have; SourceError if the port is gone."""
    if not Path(path).exists():
        raise SourceError(f"{path} is gone")
    _say(f"{name}: {error}")


def _row(source: Source, functions: Sequence[int]) -> tuple[str, ...]:
    kinds = ", ".join(KINDS[function] for function in functions) or "none: see its manual"
    return str(source["unit"]), str(source.get("baud", "-")), str(source.get("parity", "-")), kinds


def _init_command(source: Source) -> str:
    """Return the command that writes a configuration with a source."""
    if source["kind"] == "modbus-tcp":
        host = f"[{source['host']}]" if ":" in str(source["host"]) else source["host"]
        where = f"tcp://{host}:{source['port']}"
    else:
        where = f"{'serial' if source['kind'] == 'serial' else 'rtu'}:{source['port']}"
    keys = [key for key in ("baud", "parity", "unit", "function", "timeout_ms") if key in source]
    options = " ".join(f"--{key.replace('_', '-')} {source[key]}" for key in keys)
    return f"beamtouch-daemon init daemon.toml --model-config FILE --source {shlex.quote(where)} {options}"


def _describe(hello: Hello) -> str:
    if not hello.is_compatible:
        return f"it speaks protocol {hello.protocol_version}, another than this daemon; update the older of the two"
    return f"{hello.channel_count} channels, {hello.adc_bits} ADC bits, at most {hello.max_rate_hz} readings per second"


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
