"""Waiting, without holding up the event loop, for what is elsewhere."""

import asyncio
from collections.abc import Callable


async def until(holds: Callable[[], bool]) -> None:
    """Poll until a condition holds."""
    async with asyncio.timeout(60):
        while not holds():  # noqa: ASYNC110 - what it asks for is elsewhere
            await asyncio.sleep(0.01)
