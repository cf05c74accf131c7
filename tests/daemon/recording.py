"""Recordings of known loads: dialogues over a pipe, devices that are loaded, and what is in the file."""

import asyncio
import csv
import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from pymodbus.simulator.simdevice import SimAction

from support.surfaces import configs

from .devices import pymodbus_server
from .process import Outcome, started

DOWN, REST, UP = 21_000, 20_000, 19_000
"""Counts of the second channel under a load, without one, and lifted."""
PLATE_LIMITS = "\n[surfaces.bench.loads]\nx_mm = [0.0, 400.0]\ny_mm = [0.0, 300.0]\nmax_force_n = 20.0\n"
LIMITS = "\n[surfaces.bench.loads]\nposition_mm = [0.0, 400.0]\nmax_force_n = 20.0\n"
Turn = str | tuple[int, str]
"""An answer, with the counts of the second channel from then on if they change."""


def rows_of(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file; none without a file, as there is none without a load."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def stated(path: Path) -> list[tuple[str, str, str]]:
    """Return the loads in a file: number, position and force."""
    return sorted({(row["load"], row["position_mm"], row["force_n"]) for row in rows_of(path)})


def noisy(moves_after: int, counts_per_reading: float) -> SimAction:
    """Return what makes a device noisy, and lets its load move after so many readings."""
    chance, readings = random.Random(7), 0  # noqa: S311

    async def action(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        nonlocal readings
        readings += 1
        moved = counts_per_reading * max(0, readings - moves_after)
        now[0] = round(REST + chance.gauss(0, 20))
        now[1] = round(DOWN + moved + chance.gauss(0, 20))

    return action


async def talk(
    folder: Path,
    turns: Sequence[Turn],
    *options: object,
    action: SimAction | None = None,
    code: str = "",
    surface: Callable[[int], str] = lambda port: configs.surface(source=configs.tcp(port)),
    limits: str = LIMITS,
) -> Outcome:
    """Answer the questions of `record`, which writes loads.csv; the second channel is down until a turn changes it.

    `surface` makes the tables of a surface from the port of the device.
    """
    second = DOWN

    async def loaded(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        now[1] = second

    async with pymodbus_server([20_000, DOWN, 0, 0], action or loaded) as port:
        config = configs.write(folder, surface(port) + limits)
        words = ("-o", folder / "loads.csv", "--seconds", 0.2, *options)
        async with asyncio.timeout(120), started("record", config, *map(str, words), code=code) as daemon:
            said = ""
            for turn in turns:
                said += await daemon.said("): ")
                second, answer = (second, turn) if isinstance(turn, str) else turn
                daemon.answer(answer)
            outcome = await daemon.end()
    return replace(outcome, err=said + outcome.err)
