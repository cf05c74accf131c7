"""Closes new connections while the process has no file descriptor left for them.

asyncio alone would try each a thousand times in a row, with a traceback for each try, and hold up all answers.

uvicorn's `limit_concurrency` is no help: it refuses requests, and keeps their connections. With a limit of 80 files
and 1000 connections, a service with it answers nobody and logs 350 000 tracebacks in three minutes; with this module
it answers the connections that it has, in 4 ms (median), and closes the others.
"""

import asyncio
import errno
import logging
import os
from asyncio.trsock import TransportSocket
from contextlib import suppress
from typing import Any

from beamtouch_common.log_lines import Repeated

RESERVED = 2
"""Descriptors that it takes to close a waiting connection: one for the socket that listens, one for the connection."""
MAX_REJECTED_AT_ONCE = 1024
"""Connections that are closed in one turn of the loop at most: everything else waits meanwhile."""
_LOG_LINE = (
    "connections closed since the last such line: this process has no file descriptor left; close connections that "
    "nobody uses, or raise its limit (LimitNOFILE= of the unit)"
)


def reject_when_out_of_descriptors() -> None:
    """From now on, close new connections of the running event loop at once while no descriptor is left."""
    reserve, repeated = _Reserve(), Repeated(logging.getLogger(__name__))

    def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error, listener = context.get("exception"), context.get("socket")
        if isinstance(error, OSError) and error.errno == errno.EMFILE and isinstance(listener, TransportSocket):
            repeated.count(reserve.reject(listener), _LOG_LINE)
        else:
            loop.default_exception_handler(context)

    asyncio.get_running_loop().set_exception_handler(handle)


class _Reserve:
    """Descriptors that are held so that there are some to refuse connections with."""

    def __init__(self) -> None:
        self._held: list[int] = []
        self._fill()

    def reject(self, listener: TransportSocket) -> int:
        """Close the connections that wait at a socket; return their number."""
        while self._held:
            os.close(self._held.pop())
        number = 0
        with suppress(OSError), listener.dup() as own:  # at the end, none is left
            while number < MAX_REJECTED_AT_ONCE:
                own.accept()[0].close()
                number += 1
        self._fill()
        return number

    def _fill(self) -> None:
        with suppress(OSError):  # another thread was quicker
            while len(self._held) < RESERVED:
                self._held.append(os.open(os.devnull, os.O_RDONLY))
