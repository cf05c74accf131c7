"""`scan`: finds the units on a Modbus bus or behind a Modbus TCP address, or the board on a serial line. Only reads."""

import argparse
import asyncio
import json
import sys
from collections.abc import AsyncGenerator
from contextlib import aclosing
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic

from beamtouch_common.commands import DONE, FAILED
from beamtouch_common.errors import FailedError, InputError
from beamtouch_daemon.commands import scan_text
from beamtouch_daemon.commands.scan_plan import LinePlan, NetworkPlan, duration, plan_of
from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.exits import complain
from beamtouch_daemon.sources import port
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.sources.scan_line import scan_board, scan_units
from beamtouch_daemon.sources.scan_network import scan_tcp
from beamtouch_daemon.sources.scanned_unit import Asked, FoundUnit
from beamtouch_protocol.messages import Hello

FIRST_BAUD = 9600
"""Every port has this rate: whether it can be opened does not depend on the settings to try."""
PROGRESS_S = 5.0
"""Time between two lines of progress."""


@dataclass
class Found:
    """What answered."""

    units: list[FoundUnit] = field(default_factory=list)
    board: tuple[int, Hello] | None = None
    """Baud rate and hello."""
    late: set[int] = field(default_factory=set)
    """Units whose answers came too late."""
    heard: int = 0
    """Received bytes that were no answer in time."""
    asked: int = 0
    """Units that were asked, once for each of the line settings."""

    def __bool__(self) -> bool:
        return bool(self.units or self.board)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError for wrong arguments, FailedError if the line or the address cannot be opened.

    Ctrl-C and a line that is unplugged end it with a report of what was found before.
    """
    plan = plan_of(arguments)
    if isinstance(plan, LinePlan):
        _require_line(plan.path)
    _say(f"{plan}; {duration(plan)}; Ctrl-C ends it")
    found = Found()
    try:
        asyncio.run(_scan_line(plan, found) if isinstance(plan, LinePlan) else _scan_network(plan, found))
    except KeyboardInterrupt:  # enough was found
        _report(plan, found, as_json=arguments.json and bool(found))
        raise
    except SourceError as error:
        _report(plan, found, as_json=arguments.json and bool(found))
        raise FailedError(str(error)) from None
    _report(plan, found, as_json=arguments.json)
    if found:
        return DONE
    complain(_failure(plan, found))
    return FAILED


def _require_line(path: str) -> None:
    """Raise InputError if this is no serial port."""
    if not path.startswith(("/", ".")) and not Path(path).exists():
        message = f"{path!r} is neither a serial port nor an address; give /dev/ttyUSB0, for example, or tcp://HOST"
        raise InputError(message)
    if not Path(path).exists():
        message = f"{path} does not exist; plug the device in or correct the path"
        raise InputError(message)


def _report(plan: LinePlan | NetworkPlan, found: Found, *, as_json: bool) -> None:
    """Print what answered."""
    if as_json:
        print(json.dumps(scan_text.as_json(plan, found.units, found.board)))
    elif found:
        print("\n".join(scan_text.lines(plan, found.units, found.board)))


def _failure(plan: LinePlan | NetworkPlan, found: Found) -> str:
    """Return why nothing was found, and what to do."""
    if isinstance(plan, LinePlan) and not found.asked:
        return f"{plan.path} refuses these line settings, so no Modbus unit was asked; try others"
    if found.late:
        return f"nothing answers in time; {scan_text.late(plan, found.late)}"
    if found.heard:
        return f"{found.heard} bytes came, but no answers: {scan_text.TALK}"
    return f"nothing answers: {scan_text.check(plan)}"


async def _scan_line(plan: LinePlan, found: Found) -> None:
    """Look for units and for a board; SourceError if the port cannot be opened, or is gone.

    A board is looked for after the first line settings: its frames come only to a line on which no unit has answered.
    """
    port.close(port.opened(plan.path, FIRST_BAUD))
    first, *others = plan.settings
    await _scan_settings(plan, first, found)
    if not found.units:
        await _scan_boards(plan, found)
    for settings in others if found.board is None else ():
        await _scan_settings(plan, settings, found)


async def _scan_boards(plan: LinePlan, found: Found) -> None:
    for baud in plan.board_bauds:
        try:
            hello = await scan_board(plan.path, baud)
        except SourceError as error:
            await _refused(plan, f"{baud} baud", error)
            continue
        _say(f"{baud} baud: {'no ' if hello is None else 'a '}Beamtouch board")
        if hello is not None:
            found.board = baud, hello
            return


async def _refused(plan: LinePlan, settings: str, error: SourceError) -> None:
    """Say that a port does not have these settings: pseudo-terminals have no parity. SourceError if it is gone."""
    if not await asyncio.to_thread(Path(plan.path).exists):
        message = f"{plan.path} is gone"
        raise SourceError(message)
    _say(f"{settings}: not tried: {error}")


async def _scan_settings(plan: LinePlan, settings: ModbusRtu, found: Found) -> None:
    """Ask all units that have not answered with other line settings."""
    left = [unit for unit in plan.units if unit not in {one.unit for one in found.units}]
    if not left:
        return
    name = f"{settings.baud} baud, parity {settings.parity}"
    before = len(found.units)
    try:
        await _collect(scan_units(settings, left), _Progress(name, len(left)), found)
    except SourceError as error:
        await _refused(plan, name, error)
        return
    if len(found.units) == before:
        _say(f"{name}: nothing")


async def _scan_network(plan: NetworkPlan, found: Found) -> None:
    answers = scan_tcp(plan.host, plan.port, plan.units, plan.timeout_ms)
    await _collect(answers, _Progress(plan.url, len(plan.units)), found)


async def _collect(answers: AsyncGenerator[Asked, None], progress: "_Progress", found: Found) -> None:
    async with aclosing(answers) as each:
        async for one in each:
            found.asked += 1
            found.heard += one.heard
            found.late |= one.late
            progress.asked(one)
            if one.found is not None:
                found.units.append(one.found)


class _Progress:
    """Says which units answer, and now and then how far a scan has come."""

    def __init__(self, name: str, units: int) -> None:
        self._name = name
        self._units = units
        self._asked = 0
        self._said_s = monotonic()

    def asked(self, one: Asked) -> None:
        """Count a unit that was asked."""
        self._asked += 1
        for unit in one.late:
            _say(f"{self._name}: unit {unit} answers too late")
        if one.found is not None:
            _say(f"{self._name}: unit {one.unit} answers")
        elif monotonic() - self._said_s >= PROGRESS_S:
            self._said_s = monotonic()
            _say(f"{self._name}: {self._asked} of {self._units} units asked, the last is {one.unit}")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
