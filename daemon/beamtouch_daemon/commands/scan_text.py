"""The report of `scan`: a table, and for each line the `[source]` table and the `init` command that fit."""

import math
import shlex
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

from beamtouch_daemon.commands.argument_types import MAX_TIMEOUT_MS, ranges
from beamtouch_daemon.commands.init_text import toml_of
from beamtouch_daemon.commands.scan_plan import RTU_TIMEOUT_MS, TCP_TIMEOUT_MS, LinePlan, NetworkPlan
from beamtouch_daemon.sources.scanned_unit import FoundUnit, Function
from beamtouch_protocol.messages import Hello

Board = tuple[int, Hello]
"""Baud rate and hello."""
Settings = dict[str, str | float]
"""Keys of a `[source]` table."""
TALK = "another master, another program or a device that talks by itself? Stop it, or try --baud and --parity"
"""What to do if something talks on a line."""
_NAMES: dict[Function, str] = {4: "input registers", 3: "holding registers"}


def lines(plan: LinePlan | NetworkPlan, units: Sequence[FoundUnit], board: Board | None) -> Iterator[str]:
    """Return the report of what answered."""
    if board is not None:
        baud, hello = board
        yield f"a Beamtouch board at {baud} baud: {_said(hello)}"
        yield from _advised(plan, _board_source(plan, baud), "")
    if units:
        yield from _table(units)
    readable = [one for one in units if any(one.registers.values())]
    for _, group in groupby(sorted(readable or units, key=_settings), key=_settings):
        alike = list(group)
        yield from _advised(plan, source_of(plan, alike[0]), "; ".join(_hints(plan, alike)))


def _hints(plan: LinePlan | NetworkPlan, alike: Sequence[FoundUnit]) -> Iterator[str]:
    """Return what to know of units that the same source reads."""
    first, *others = alike
    if isinstance(plan, NetworkPlan) and len(plan.units) == len(alike) > 1:
        yield "it answers as every unit, so it is probably one device"
    elif others:
        yield f"a channel of unit {ranges([one.unit for one in others])} states its unit"
    if not any(first.registers.values()):
        yield "registers do not begin at 0: see the manual of the device"
    if all(first.registers.values()):
        yield "or function = 3: its manual says where the inputs are"


def source_of(plan: LinePlan | NetworkPlan, one: FoundUnit) -> Settings:
    """Return the keys of the `[source]` table that reads a unit."""
    if isinstance(plan, NetworkPlan):
        where: Settings = {"kind": "modbus-tcp", "host": plan.host, "port": plan.port}
    else:
        where = {"kind": "modbus-rtu", "port": plan.path, "baud": one.baud or 0, "parity": one.parity or ""}
    return where | {"unit": one.unit, "function": one.function, "timeout_ms": math.ceil(_timeout_ms(plan))}


def as_json(plan: LinePlan | NetworkPlan, units: Sequence[FoundUnit], board: Board | None) -> dict[str, object]:
    """Return the report as one object for JSON."""
    target = plan.path if isinstance(plan, LinePlan) else plan.url
    found: list[dict[str, object]] = [
        {
            "unit": one.unit,
            "baud": one.baud,
            "parity": one.parity,
            "input_registers": one.registers[4],
            "holding_registers": one.registers[3],
            "source": source_of(plan, one),
        }
        for one in units
    ]
    said = None
    if board is not None:
        baud, hello = board
        said = {
            "baud": baud,
            "channels": hello.channel_count,
            "adc_bits": hello.adc_bits,
            "max_rate_hz": hello.max_rate_hz,
            "is_compatible": hello.is_compatible,
            "source": _board_source(plan, baud),
        }
    return {"target": target, "units": found, "board": said}


def check(plan: LinePlan | NetworkPlan) -> str:
    """Return what to check after nothing answered."""
    more = f"try --units 1-247 or --timeout-ms {_longer_ms(plan)}"
    if isinstance(plan, NetworkPlan):
        return f"{plan.url} accepts connections; check the unit numbers of the device, or {more}"
    return f"check power, wiring (A and B swapped?) and the address of the device, stop other masters, or {more}"


def late(plan: LinePlan | NetworkPlan, units: Iterable[int]) -> str:
    """Return how to find units whose answers came too late."""
    which = ranges(sorted(units))
    return f"unit {which} answers later than {_timeout_ms(plan):g} ms: add --timeout-ms {_longer_ms(plan)}"


def _timeout_ms(plan: LinePlan | NetworkPlan) -> float:
    return plan.timeout_ms if isinstance(plan, NetworkPlan) else plan.settings[0].timeout_ms


def _longer_ms(plan: LinePlan | NetworkPlan) -> int:
    """Return a timeout to try next; a gateway waits in vain for absent units before it answers."""
    return round(min(_timeout_ms(plan) * (10 if isinstance(plan, NetworkPlan) else 5), MAX_TIMEOUT_MS))


def _settings(one: FoundUnit) -> tuple[int, str, int]:
    return one.baud or 0, one.parity or "", one.function


def _table(units: Sequence[FoundUnit]) -> Iterator[str]:
    rows = [("unit", "baud", "parity", *_NAMES.values())]
    rows += [
        (str(one.unit), str(one.baud or "-"), one.parity or "-", *(_span(one.registers[each]) for each in _NAMES))
        for one in units
    ]
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def _span(count: int) -> str:
    return "none from 0" if not count else "0" if count == 1 else f"0-{count - 1}"


def _advised(plan: LinePlan | NetworkPlan, settings: Settings, hint: str) -> Iterator[str]:
    """Return the table for a configuration, and the command that writes one."""
    yield f"\n[surfaces.NAME.source]{f'    # {hint}' if hint else ''}"
    yield from toml_of(settings)
    if isinstance(plan, NetworkPlan):
        where = plan.url
    else:
        where = f"{'serial' if settings['kind'] == 'serial' else 'rtu'}:{plan.path}"
    keys = ["baud", "parity", "unit", "function"]
    default_ms = TCP_TIMEOUT_MS if isinstance(plan, NetworkPlan) else RTU_TIMEOUT_MS
    if settings.get("timeout_ms") not in (None, default_ms):
        keys.append("timeout_ms")
    options = " ".join(f"--{key.replace('_', '-')} {settings[key]}" for key in keys if key in settings)
    yield f"\nbeamtouch-daemon init daemon.toml --model-config FILE --source {shlex.quote(where)} {options}"


def _board_source(plan: LinePlan | NetworkPlan, baud: int) -> Settings:
    return {"kind": "serial", "port": plan.path if isinstance(plan, LinePlan) else "", "baud": baud}


def _said(hello: Hello) -> str:
    if not hello.is_compatible:
        return f"it speaks protocol {hello.protocol_version}, another than this daemon; update the older of the two"
    return f"{hello.channel_count} channels, {hello.adc_bits} ADC bits, at most {hello.max_rate_hz} readings per second"
