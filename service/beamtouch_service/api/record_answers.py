"""Answers from the record: each takes one of a bounded number of slots until its client has it."""

from collections.abc import AsyncIterator

from fastapi import Depends, Response
from starlette.types import Receive, Scope, Send

from beamtouch_service.api.context import ContextParameter

_PIECE_BYTES = 64 * 1024
"""An answer goes out in pieces of this size. Others get their turn between two of them."""


async def _have_slot(context: ContextParameter) -> AsyncIterator[None]:
    async with context.recorder.readers.slot():
        yield


SLOT = Depends(_have_slot)
"""Of a route that reads the record."""


class Pieces(Response):
    """An answer of which the next piece goes out once the client has taken most of those before."""

    async def __call__(self, _scope: Scope, _receive: Receive, send: Send) -> None:
        """Send it."""
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        for start in range(0, len(self.body), _PIECE_BYTES):
            piece = self.body[start : start + _PIECE_BYTES]
            await send({"type": "http.response.body", "body": piece, "more_body": True})
        await send({"type": "http.response.body", "body": b""})
