"""Refuses connections while the process has no file descriptor left for them.

asyncio alone would try each a thousand times in a row, with a traceback for each try, and hold up all answers.
"""

import asyncio
import errno
import logging
import os
from asyncio.trsock import TransportSocket
from contextlib import suppress
from typing import Any

from beamtouch_common.log import Repeated

NEEDED = 2
"""Descriptors that it takes to refuse connections: one for the socket that listens, one for the connection."""
MOST = 1024
"""Limit of connections that are refused in one go: all others wait meanwhile."""
_WORDS = (
    "connections closed since the last such line: this process has no file descriptor left; close connections that "
    "nobody uses, or raise its limit (LimitNOFILE= of the unit)"
)


def refuse_beyond_open_files() -> None:
    """From now on, close new connections of the running event loop at once while no descriptor is left."""
    reserve, repeated = _Reserve(), Repeated(logging.getLogger(__name__))

    def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error, listener = context.get("exception"), context.get("socket")
        if isinstance(error, OSError) and error.errno == errno.EMFILE and isinstance(listener, TransportSocket):
            repeated.count(reserve.refuse(listener), _WORDS)
        else:
            loop.default_exception_handler(context)

    asyncio.get_running_loop().set_exception_handler(handle)


class _Reserve:
    """Descriptors that are held so that there are some to refuse connections with."""

    def __init__(self) -> None:
        self._held: list[int] = []
        self._fill()

    def refuse(self, listener: TransportSocket) -> int:
        """Close the connections that wait at a socket; return their number."""
        while self._held:
            os.close(self._held.pop())
        number = 0
        with suppress(OSError), listener.dup() as own:  # at the end, none is left
            while number < MOST:
                own.accept()[0].close()
                number += 1
        self._fill()
        return number

    def _fill(self) -> None:
        with suppress(OSError):  # another thread was quicker
            while len(self._held) < NEEDED:
                self._held.append(os.open(os.devnull, os.O_RDONLY))
