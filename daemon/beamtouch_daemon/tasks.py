"""Tasks that run until the daemon stops, and their cancellation."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

RESTART_S = 2.0
"""Pause after an unexpected error."""
_CANCEL_AGAIN_S = 0.1
_log = logging.getLogger(__name__)


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


async def keep_going(name: str, work: Callable[[], Awaitable[None]]) -> None:
    """Run `work` to its end; after an unexpected error, log it and start `work` again."""
    while True:
        try:
            await work()
        except Exception:  # noqa: BLE001 - logged whole; one surface's fault must not stop the others
            _log.exception("%s: unexpected error; restarting", name)
            await asyncio.sleep(RESTART_S)
        else:
            return
