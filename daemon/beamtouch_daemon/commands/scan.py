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
from beamtouch_common.errors import FailedError
from beamtouch_daemon.commands import scan_text
from beamtouch_daemon.commands.scan_plan import LinePlan, NetworkPlan, duration, plan_of
from beamtouch_daemon.config.file import require_port
from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.exits import complain
from beamtouch_daemon.sources import port
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.sources.scan_line import scan_board, scan_units
from beamtouch_daemon.sources.scan_network import scan_tcp
from beamtouch_daemon.sources.scanned_unit import FoundUnit
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


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError for wrong arguments, FailedError if the line or the address cannot be opened."""
    plan = plan_of(arguments)
    if isinstance(plan, LinePlan):
        require_port(plan.path)
    _say(f"{plan}; {duration(plan)}; Ctrl-C ends it")
    found = Found()
    try:
        asyncio.run(_scan_line(plan, found) if isinstance(plan, LinePlan) else _scan_network(plan, found))
    except SourceError as error:
        raise FailedError(str(error)) from None
    if arguments.json:
        print(json.dumps(scan_text.as_json(plan, found.units, found.board)))
    elif found.units or found.board:
        print("\n".join(scan_text.lines(plan, found.units, found.board)))
    if found.units or found.board:
        return DONE
    complain(f"nothing answers: {scan_text.advice(plan)}")
    return FAILED


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
        except SourceError:
            await _refused(plan, f"{baud} baud")
            continue
        _say(f"{baud} baud: {'no ' if hello is None else 'a '}Beamtouch board")
        if hello is not None:
            found.board = baud, hello
            return


async def _refused(plan: LinePlan, settings: str) -> None:
    """Say that a port does not have these settings: pseudo-terminals have no parity. SourceError if it is gone."""
    if not await asyncio.to_thread(Path(plan.path).exists):
        message = f"{plan.path} is gone"
        raise SourceError(message)
    _say(f"{settings}: not tried, {plan.path} refuses it")


async def _scan_settings(plan: LinePlan, settings: ModbusRtu, found: Found) -> None:
    """Ask all units that have not answered with other line settings."""
    left = [unit for unit in plan.units if unit not in {one.unit for one in found.units}]
    if not left:
        return
    name = f"{settings.baud} baud, parity {settings.parity}"
    before = len(found.units)
    try:
        await _collect(scan_units(settings, left), _Progress(name, len(left)), found)
    except SourceError:
        await _refused(plan, name)
        return
    if len(found.units) == before:
        _say(f"{name}: nothing")


async def _scan_network(plan: NetworkPlan, found: Found) -> None:
    answers = scan_tcp(plan.host, plan.port, plan.units, plan.timeout_ms)
    await _collect(answers, _Progress(plan.url, len(plan.units)), found)


async def _collect(
    answers: AsyncGenerator[tuple[int, FoundUnit | None], None], progress: "_Progress", found: Found
) -> None:
    async with aclosing(answers) as each:
        async for unit, one in each:
            progress.asked(unit, answers=one is not None)
            if one is not None:
                found.units.append(one)


class _Progress:
    """Says which units answer, and now and then how far a scan has come."""

    def __init__(self, name: str, units: int) -> None:
        self._name = name
        self._units = units
        self._asked = 0
        self._said_s = monotonic()

    def asked(self, unit: int, *, answers: bool) -> None:
        """Count a unit that was asked."""
        self._asked += 1
        if answers:
            _say(f"{self._name}: unit {unit} answers")
        elif monotonic() - self._said_s >= PROGRESS_S:
            self._said_s = monotonic()
            _say(f"{self._name}: {self._asked} of {self._units} units asked, the last is {unit}")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
