"""Recordings of known loads: answers from a pipe or a terminal, devices that are loaded, and what is in the file."""

import asyncio
import csv
import os
import random
import subprocess
import sys
from pathlib import Path

from pymodbus.simulator.simdevice import SimAction

from forked import Forked

from . import configs
from .devices import pymodbus_server
from .process import COMMAND


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def record(config: Path, path: Path, typed: str, *options: object) -> subprocess.CompletedProcess[str]:
    """Record with answers from a pipe."""
    process = Forked(COMMAND, ["record", str(config), "-o", str(path), *map(str, options)], Path.cwd())
    out, err = process.communicate(typed, timeout=120)
    return subprocess.CompletedProcess(process.args, process.wait(), out, err)


def record_at_terminal(config: Path, path: Path, typed: str, *options: object) -> subprocess.CompletedProcess[str]:
    """Record with answers from a terminal."""
    program = [sys.executable, "-m", "beamtouch_daemon", "record", str(config), "-o", str(path)]
    near, far = os.openpty()
    try:
        os.write(near, typed.encode())
        return subprocess.run(
            [*program, *map(str, options)], stdin=far, capture_output=True, text=True, timeout=120, check=False
        )
    finally:
        os.close(near)
        os.close(far)


LIMITS = "\n[surfaces.bench.loads]\nposition_mm = [0.0, 400.0]\nmax_force_n = 20.0\n"


async def on_beam(
    typed: str, folder: Path, *options: object, at_terminal: bool = False, action: SimAction | None = None
) -> subprocess.CompletedProcess[str]:
    """Record to loads.csv from a device whose second channel is 0.1 mm down, or one that does as it is told."""

    async with pymodbus_server([20_000, 21_000], action) as port:
        config = configs.write(folder, configs.surface(source=configs.tcp(port)) + LIMITS)
        run = record_at_terminal if at_terminal else record
        return await asyncio.to_thread(run, config, folder / "loads.csv", typed, *options)


def stated(path: Path) -> list[tuple[str, str, str]]:
    """Return the loads in a file: number, position and force."""
    return sorted({(row["load"], row["position_mm"], row["force_n"]) for row in rows_of(path)})


def noisy(moves_after: int, counts_per_reading: float, loaded: float = 1000.0) -> SimAction:
    """Return what makes a device noisy, and lets its load move after so many readings."""
    chance, readings = random.Random(7), 0  # noqa: S311

    async def action(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        nonlocal readings
        readings += 1
        moved = counts_per_reading * max(0, readings - moves_after)
        now[0] = round(20_000 + chance.gauss(0, 20))
        now[1] = round(20_000 + loaded + moved + chance.gauss(0, 20))

    return action


async def talk(folder: Path, turns: list[tuple[int, str]], *options: object) -> tuple[int, str]:
    """Answer the questions of `record` from a pipe; return the exit code and what it printed.

    Before each answer, the second channel gets the counts of that turn.
    """
    second = 20_000

    async def action(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        now[1] = second

    async with pymodbus_server([20_000, 20_000], action) as port:
        config = configs.write(folder, configs.surface(source=configs.tcp(port)) + LIMITS)
        program = ["-m", "beamtouch_daemon", "record", config, "-o", folder / "loads.csv", "--seconds", 0.2]
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(
            sys.executable, *map(str, [*program, *options]), stdin=pipe, stderr=pipe
        )
        assert process.stdin is not None
        assert process.stderr is not None
        said = ""
        async with asyncio.timeout(120):
            for counts, answer in turns:
                said += (await process.stderr.readuntil(b"): ")).decode()  # the end of a question
                second = counts
                process.stdin.write(f"{answer}\n".encode())
            process.stdin.close()
            said += (await process.stderr.read()).decode()
            return await process.wait(), said
