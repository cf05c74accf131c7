"""Reading a source to the number of readings that a test needs."""

import asyncio
from contextlib import aclosing

from beamtouch_daemon.sources.reading import Reading, Source, SourceError


async def take(source: Source, number: int) -> list[Reading]:
    """Return the first readings of one session."""
    readings: list[Reading] = []
    async with aclosing(source.readings()) as stream:
        async for arrived in stream:
            readings += arrived
            if len(readings) >= number:
                break
    return readings


async def take_across_sessions(source: Source, number: int) -> tuple[list[Reading], list[str]]:
    """Return readings and the errors in between, opening anew after each."""
    readings: list[Reading] = []
    errors: list[str] = []
    async with asyncio.timeout(20):
        while len(readings) < number:
            try:
                async with aclosing(source.readings()) as stream:
                    async for arrived in stream:
                        readings += arrived
                        if len(readings) >= number:
                            break
            except SourceError as error:
                errors.append(str(error))
                await asyncio.sleep(0.1)
    return readings, errors
