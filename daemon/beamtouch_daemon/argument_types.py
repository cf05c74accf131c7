"""Types of arguments: addresses, lists of units and of baud rates, times."""

import argparse
import re
from collections.abc import Callable, Sequence

from beamtouch_common.errors import InputError
from beamtouch_common.hosts import tcp_address

RTU_UNITS = range(1, 248)
TCP_UNITS = range(256)
MODBUS_PORT = 502
BAUDS = range(300, 12_000_001)
MAX_TIMEOUT_MS = 60_000.0


def address_of(text: str) -> tuple[str, int]:
    """Return host and port of tcp://HOST[:PORT]; InputError if it is something else."""
    try:
        host, port = tcp_address(text)
    except ValueError:
        message = f"{text!r} is not an address; give tcp://HOST[:PORT], such as tcp://192.168.0.20:502"
        raise InputError(message) from None
    return host, port or MODBUS_PORT


def numbers(text: str) -> tuple[int, ...]:
    """Return the unit numbers in a list such as 1-16,20; ArgumentTypeError if it is not one."""
    units: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"(\d{1,3})(?:-(\d{1,3}))?", part.strip(), re.ASCII)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if first > last or last not in TCP_UNITS:
            message = f"{text!r} is not a list of unit numbers from 0 to 255, such as 1-16 or 1,2,20-30"
            raise argparse.ArgumentTypeError(message)
        units += range(first, last + 1)
    return tuple(dict.fromkeys(units))


def ranges(units: Sequence[int]) -> str:
    """Return unit numbers as text: 1-16, 255."""
    runs: list[tuple[int, int]] = []
    for unit in units:
        if runs and unit == runs[-1][1] + 1:
            runs[-1] = (runs[-1][0], unit)
        else:
            runs.append((unit, unit))
    return ", ".join(f"{first}-{last}" if last > first else str(first) for first, last in runs)


def bauds(text: str) -> tuple[int, ...]:
    """Return the baud rates in a list such as 9600,19200; ArgumentTypeError if it is not one."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isascii() and part.isdecimal() and len(part) < 10 and int(part) in BAUDS for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of baud rates, such as 9600,19200")
    return tuple(dict.fromkeys(map(int, parts)))


def parities(text: str) -> tuple[str, ...]:
    """Return the parities in a list such as none,even; ArgumentTypeError if it is not one."""
    parts = [part.strip() for part in text.split(",")]
    if not set(parts) <= {"none", "even", "odd"}:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of parities; choose of none,even,odd")
    return tuple(dict.fromkeys(parts))


def between(low: float, high: float, unit: str) -> Callable[[str], float]:
    """Return the type of an argument that is a number within a range."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number of {unit} from {low:g} to {high:g}")
        return value

    return number
