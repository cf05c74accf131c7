"""The daemon on a Modbus RTU bus never takes an old value for a new one, seen from the line and from its samples."""

import asyncio
import time
from pathlib import Path

import pytest

from . import configs
from .devices import Pieces, StampingUnit, rtu_units
from .faulty import plain, running
from .lines import terminal
from .process import command
from .service import Service, serving

pytestmark = pytest.mark.anyio

TIMEOUT_MS = 300
ROUNDING_S = 0.002
"""Of the unit's clock, which counts milliseconds, and of the times of samples."""
STARTS = 5


def table(path: str) -> str:
    return f'kind = "modbus-rtu"\nport = "{path}"\ntimeout_ms = {TIMEOUT_MS}'


def kind_of(frame: bytes) -> bytes:
    """Return the function and the length by which the daemon knows an answer."""
    return frame[1:3]


VALUE = bytes([4, 4])
"""Two input registers."""


async def ages_s(folder: Path, unit: StampingUnit, number: int) -> list[float]:
    """Return how much older than stated the values of this many samples are; the request's time is the latest."""
    offset_s = time.time() - time.monotonic()
    with terminal() as line:
        async with (
            rtu_units(line, {1: unit}),
            serving(Service()) as service,
            running(folder, table(line.path), service.url) as daemon,
        ):
            await service.until(number)
            await daemon.stop()
            return [
                unit.age_s(-sample.deflection_mm[0], sample.acquired_unix_us / 1e6 - offset_s)
                for sample in service.samples()
                if sample.deflection_mm[0] is not None
            ]


async def test_the_late_answer_to_a_repeated_probe_proves_nothing_of_what_was_asked_since(tmp_path: Path) -> None:
    asked: list[bytes] = []
    repeated = 0

    def late(_number: int, frame: bytes) -> Pieces:
        nonlocal repeated
        kind = kind_of(frame)
        is_repeated = kind != VALUE and asked[-1:] == [kind]
        asked.append(kind)
        repeated += is_repeated
        # The answer to each 20th value comes during the second try of a probe; that try is then answered late as well.
        if kind == VALUE and asked.count(VALUE) % 20 == 0:
            return [(2.5 * TIMEOUT_MS / 1e3, frame)]
        return [(1.5 * TIMEOUT_MS / 1e3 if is_repeated else 0.0, frame)]

    ages = await ages_s(tmp_path, StampingUnit(late), 60)
    assert repeated >= 2
    assert max(ages) < ROUNDING_S


async def test_copies_of_answers_are_not_believed_once_one_was_noticed(tmp_path: Path) -> None:
    held: list[bytes] = []
    values = late_copies = 0

    def copying(_number: int, frame: bytes) -> Pieces:
        nonlocal values, late_copies
        pieces = [(0.0, held.pop()), (0.003, frame)] if held else [(0.0, frame)]
        late_copies += len(pieces) - 1
        values += kind_of(frame) == VALUE
        if kind_of(frame) == VALUE and values % 10 == 0:
            held.append(frame)  # this copy comes with the answer to the next request
        elif kind_of(frame) == VALUE:
            # The first copies come right behind their answers, so that they are noticed on a busy machine, too.
            pieces.append((0.0 if values < 5 else 0.002, frame))
        return pieces

    ages = await ages_s(tmp_path, StampingUnit(copying), 60)
    assert late_copies >= 3
    assert max(ages) < ROUNDING_S


async def test_each_start_asks_its_probes_in_another_order(tmp_path: Path) -> None:
    orders = set[tuple[bytes, ...]]()
    for _ in range(STARTS):
        asked: list[bytes] = []

        def note(_number: int, frame: bytes, asked: list[bytes] = asked) -> Pieces:
            asked.append(kind_of(frame))
            return [(0.0, frame)]

        with terminal() as line:
            async with rtu_units(line, {1: StampingUnit(note)}):
                config = configs.write(tmp_path, plain(table(line.path)))
                outcome = await asyncio.wait_for(command("check", config, "--json"), 60)
        assert outcome.code == 0
        orders.add(tuple(kind for kind in asked if kind != VALUE)[:2])
    assert len(orders) > 1  # among twenty orders of two probes
