"""The plan of a scan: where, which units and line settings, and how long it takes at most. No I/O."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import get_args

from beamtouch_common.errors import InputError
from beamtouch_daemon.commands.argument_types import RTU_UNITS, address_of, ranges
from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources.scan_line import request_s
from beamtouch_daemon.sources.scan_network import CONNECT_S, tcp_request_s
from beamtouch_daemon.sources.scanned_unit import FUNCTIONS, MAX_REQUESTS, Parity
from beamtouch_daemon.sources.serial_line import HELLO_TIMEOUT_S

BAUDS = (9600, 19_200, 115_200, 38_400, 57_600)
"""The usual rates of Modbus modules, the most usual first."""
BOARD_BAUDS = (1_000_000,)
"""The rate of the boards in firmware_protocol."""
FIRST_UNITS = range(1, 17)
RTU_TIMEOUT_MS, TCP_TIMEOUT_MS = 100.0, 200.0
"""The defaults of the sources."""


@dataclass(frozen=True)
class LinePlan:
    """A scan of a serial line."""

    path: str
    board_bauds: tuple[int, ...]
    settings: tuple[ModbusRtu, ...]
    units: tuple[int, ...]

    @property
    def max_s(self) -> float:
        """Longest time until every unit was asked [s]; each unit that answers takes up to `found_s` more."""
        requests = len(self.units) * len(FUNCTIONS)
        return HELLO_TIMEOUT_S * len(self.board_bauds) + requests * sum(map(request_s, self.settings))

    @property
    def found_s(self) -> float:
        """Longest time to find the registers of a unit [s]."""
        return MAX_REQUESTS * max(map(request_s, self.settings))

    def __str__(self) -> str:
        bauds = ", ".join(map(str, dict.fromkeys(one.baud for one in self.settings)))
        parities = ", ".join(dict.fromkeys(one.parity for one in self.settings))
        boards = ", ".join(map(str, self.board_bauds))
        return (
            f"{self.path}: Modbus RTU units {ranges(self.units)} at {bauds} baud with parity {parities}, "
            f"and a Beamtouch board at {boards} baud"
        )


@dataclass(frozen=True)
class NetworkPlan:
    """A scan of a Modbus TCP device."""

    host: str
    port: int
    units: tuple[int, ...]
    timeout_ms: float

    @property
    def max_s(self) -> float:
        """Longest time until every unit was asked [s]; each unit that answers takes up to `found_s` more."""
        return max(CONNECT_S, self.timeout_ms / 1e3) + len(self.units) * len(FUNCTIONS) * tcp_request_s(self.timeout_ms)

    @property
    def found_s(self) -> float:
        """Longest time to find the registers of a unit [s]."""
        return MAX_REQUESTS * tcp_request_s(self.timeout_ms)

    @property
    def url(self) -> str:
        """The address as it is typed."""
        return f"tcp://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    def __str__(self) -> str:
        return f"{self.url}: Modbus TCP units {ranges(self.units)}"


def duration(plan: LinePlan | NetworkPlan) -> str:
    """Return how long a scan takes at most."""
    return f"at most {math.ceil(plan.max_s)} s, and {math.ceil(plan.found_s)} s more for each unit that answers"


def plan_of(arguments: argparse.Namespace) -> LinePlan | NetworkPlan:
    """Return the plan that the arguments ask for; InputError if they contradict each other."""
    target: str = arguments.target
    units: tuple[int, ...] | None = arguments.units
    if "://" in target:
        if arguments.baud is not None or arguments.parity is not None:
            message = "--baud and --parity are for a serial line; leave them out with tcp://"
            raise InputError(message)
        host, port = address_of(target)
        known = (*FIRST_UNITS, 0, 255)  # the last two mean the device itself
        return NetworkPlan(host, port, units or known, arguments.timeout_ms or TCP_TIMEOUT_MS)
    if units is not None and not set(units) <= set(RTU_UNITS):
        message = "--units: a serial line has units 1 to 247"
        raise InputError(message)
    timeout_ms = arguments.timeout_ms or RTU_TIMEOUT_MS
    parities: Sequence[Parity] = arguments.parity or get_args(Parity)
    settings = tuple(
        ModbusRtu(kind="modbus-rtu", port=target, baud=baud, parity=parity, timeout_ms=timeout_ms)
        for baud, parity in product(arguments.baud or BAUDS, parities)
    )
    return LinePlan(target, arguments.baud or BOARD_BAUDS, settings, units or tuple(FIRST_UNITS))
