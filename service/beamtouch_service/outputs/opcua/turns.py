"""The messages of all clients, one at a time, with as much time for the rest of the service as they take."""

import asyncio
from time import monotonic
from typing import Any

MIN_REST_S = 0.002
"""Shorter rests are taken together: a timer of the event loop may be late by one millisecond."""
MAX_REST_S = 1.0
"""Longest rest for one message. Its work may have waited for something itself."""


class Turns:
    """Turns of the event loop, for one message each.

    The library works through all messages that a connection has sent without giving up the event loop, and a client can
    send them without waiting for answers.
    """

    def __init__(self) -> None:
        self._next = asyncio.Lock()
        self._rested_s = 0.0
        """When the rest has had as much time as the messages so far [s, monotonic]."""

    async def wait(self) -> None:
        """Wait for the turn of a message, behind those that wait already, of other connections too."""
        async with self._next:
            rest_s = self._rested_s - monotonic()
            await asyncio.sleep(rest_s if rest_s > MIN_REST_S else 0)

    def note(self, begun_s: float) -> None:
        """Note that the work on a message is done, which began at this time [s, monotonic]."""
        now_s = monotonic()
        self._rested_s = max(self._rested_s, now_s) + min(now_s - begun_s, MAX_REST_S)


class _Messages(asyncio.Queue[Any]):
    """The messages of one connection, each given in its turn."""

    def __init__(self, maxsize: int, turns: Turns) -> None:
        super().__init__(maxsize)
        self._turns = turns
        self._given_s: float | None = None

    async def get(self) -> Any:  # noqa: ANN401  # a message is a pair of types of the library
        """Return the next message. The library calls this as soon as it has worked on the one before."""
        if self._given_s is not None:
            self._turns.note(self._given_s)
            self._given_s = None
        message = await super().get()
        await self._turns.wait()
        self._given_s = monotonic()
        return message


class Transports(list[asyncio.BaseTransport]):
    """The transports of a server, which the library lists as they come. Their messages get turns."""

    def __init__(self, max_pending: int) -> None:
        """`max_pending`: messages of one connection that may wait; with more, the library closes it."""
        super().__init__()
        self._max_pending, self._turns, self._is_ended = max_pending, Turns(), False

    def append(self, transport: asyncio.BaseTransport) -> None:
        """List the transport of a connection that begins: it has not taken a message yet."""
        protocol: Any = transport.get_protocol()
        protocol.messages = _Messages(self._max_pending, self._turns)
        super().append(transport)
        if self._is_ended:
            transport.close()

    def end(self) -> None:
        """Close all, and each that still comes.

        The library closes those that it knows before it stops to listen. One that came in between would go on reading
        from a server that nothing updates any more: its values would stay as they are, and stay good.
        """
        self._is_ended = True
        for transport in self:
            transport.close()
