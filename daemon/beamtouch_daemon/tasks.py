"""The cancellation of tasks that run until the daemon stops."""

import asyncio
from collections.abc import Iterable
from typing import Any

_CANCEL_AGAIN_S = 0.1


async def cancel(tasks: Iterable["asyncio.Future[Any]"]) -> None:
    """Cancel tasks until they are done: before Python 3.12, `wait_for` swallows a cancellation at the wrong moment."""
    left = everyone = set(tasks)
    while left:
        for task in left:
            task.cancel()
        _, left = await asyncio.wait(left, timeout=_CANCEL_AGAIN_S)
    for task in everyone:
        if not task.cancelled():
            task.exception()  # retrieved, so that asyncio does not log it at the end
