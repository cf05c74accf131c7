"""Tasks that nothing but a stop ends, and their end for sure."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from beamtouch_daemon.faults import BACKOFF_MAX_S

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
            task.exception()  # seen, so that nobody complains of it at the end


async def keep_going(name: str, work: Callable[[], Awaitable[None]]) -> None:
    """Run `work` to its end; an error that nobody foresaw ends here, in the log, and `work` begins again."""
    while True:
        try:
            await work()
        except Exception:  # noqa: BLE001 - logged whole; one surface's fault must not stop the others
            _log.exception("%s: unexpected error; starting anew", name)
            await asyncio.sleep(BACKOFF_MAX_S)
        else:
            return
