"""Reading a source to the number of readings that a test needs."""

import asyncio
import tomllib
from collections.abc import Callable
from contextlib import aclosing

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.sources.configured import Buses, source_of
from beamtouch_daemon.sources.polled import PolledSource
from beamtouch_daemon.sources.reading import Reading, Source, SourceError


def polled(source: str, registers: list[int], rate_hz: float, others: list[str] | None = None) -> PolledSource:
    """Return a Modbus source.

    Parameters
    ----------
    source
        Its table, as in the configuration.
    registers
        Of its channels.
    rate_hz
        Of the surface.
    others
        What further channels say of where they are.
    """
    places = [f"register = {register}" for register in registers] + (others or [])
    return source_in({}, source, places, rate_hz)


def source_in(buses: Buses, source: str, places: list[str], rate_hz: float) -> PolledSource:
    """Return a Modbus source of channels in these places, which shares buses with others."""
    channel = "gain_mm_per_count = 1.0\noffset_mm = 0.0\nrest_gap_mm = 0.0\nrange_mm = [0.0, 65535.0]"
    tables = [f'[[channels]]\nname = "s{index}"\n{place}\n{channel}\n' for index, place in enumerate(places)]
    text = f"rate_hz = {rate_hz}\n[source]\n{source}\n{''.join(tables)}"
    made = source_of(Surface.model_validate(tomllib.loads(text)), "bench", buses)
    assert isinstance(made, PolledSource)
    return made


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
