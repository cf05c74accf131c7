"""Reading a source to the number of readings that a test needs."""

import asyncio
import tomllib
from collections.abc import Callable
from contextlib import aclosing

import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.sources import board, rtu_unit, traffic
from beamtouch_daemon.sources.configured import Buses, source_of
from beamtouch_daemon.sources.reading import Reading, Source, SourceError, first_readings

__all__ = [
    "Buses", "Reading", "Source", "SourceError", "change_waits", "first_readings", "polled", "source_in",
    "take_across_sessions",
]  # fmt: skip


def change_waits(monkeypatch: pytest.MonkeyPatch, **waits_s: float) -> None:
    """Let sources wait for other times than those of the daemon [s].

    `forgotten_s` is that for an answer that a unit owes, `learn_again_s` that until a unit is asked again what it
    answers, `hello_s` that for a board to say what it is and to answer a ping, `silence_s` that for its readings,
    `boot_s` that for which a device may boot after its port was opened.
    """
    homes = {
        "forgotten_s": (rtu_unit, "FORGOTTEN_S"),
        "learn_again_s": (rtu_unit, "LEARN_AGAIN_S"),
        "hello_s": (board, "HELLO_TIMEOUT_S"),
        "silence_s": (board, "SILENCE_S"),
        "boot_s": (traffic, "BOOT_S"),
    }
    for name, wait_s in waits_s.items():
        module, constant = homes[name]
        monkeypatch.setattr(module, constant, wait_s)


def polled(source: str, registers: list[int], rate_hz: float, others: list[str] | None = None) -> Source:
    """Return the source that a table of the configuration describes.

    Parameters
    ----------
    source
        The table.
    registers
        Of its channels.
    rate_hz
        Of the surface.
    others
        What further channels say of where they are.
    """
    places = [f"register = {register}" for register in registers] + (others or [])
    return source_in({}, source, places, rate_hz)


def source_in(buses: Buses, source: str, places: list[str], rate_hz: float) -> Source:
    """Return a source of channels in these places, which shares buses with others."""
    channel = "gain_mm_per_count = 1.0\noffset_mm = 0.0\nrest_gap_mm = 0.0\nrange_mm = [0.0, 65535.0]"
    tables = [f'[[channels]]\nname = "s{index}"\n{place}\n{channel}\n' for index, place in enumerate(places)]
    text = f"rate_hz = {rate_hz}\n[source]\n{source}\n{''.join(tables)}"
    return source_of(Surface.model_validate(tomllib.loads(text)), "bench", buses)


async def take_across_sessions(
    source: Source, number: int, check: Callable[[Reading], None] = lambda _reading: None
) -> tuple[list[Reading], list[str]]:
    """Return readings and the errors in between, opening anew after each; `check` sees each reading as it comes."""
    readings: list[Reading] = []
    errors: list[str] = []
    async with asyncio.timeout(60):
        while len(readings) < number:
            try:
                async with aclosing(source.readings()) as stream:
                    async for arrived in stream:
                        for reading in arrived:
                            check(reading)
                        readings += arrived
                        if len(readings) >= number:
                            break
            except SourceError as error:
                errors.append(str(error))
                await asyncio.sleep(0.1)
    return readings, errors
