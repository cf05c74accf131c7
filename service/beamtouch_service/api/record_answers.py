"""Answers from the record: each takes one of a bounded number of slots until its client has it."""

import logging
from collections.abc import AsyncIterator, Callable, Iterator, Mapping

from fastapi import Depends
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from beamtouch_common.log_lines import Repeated
from beamtouch_service.api.context import IS_HEAD, Context, ContextParameter
from beamtouch_service.record import Reader, RecordAwayError, UnreadableRowError

_log = logging.getLogger(__name__)
_repeated = Repeated(_log)


async def _have_slot(context: ContextParameter) -> AsyncIterator[None]:
    async with context.recorder.readers.slot():
        yield


SLOT = Depends(_have_slot)
"""Of a route that reads the record."""


class _Parts(StreamingResponse):
    """An answer whose next part is made once the client has taken most of those before."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it; to HEAD, its headers, and no further part is made."""
        if scope.get(IS_HEAD):
            self.body_iterator = _no_parts()
        await super().__call__(scope, receive, send)

    async def stream_response(self, send: Send) -> None:
        """Send it. If its end cannot be read, close the connection before it: no client takes the answer for whole."""
        try:
            await super().stream_response(send)
        except RecordAwayError as error:
            # All damaged rows share one limit: a file may have thousands.
            reason = "damage" if isinstance(error, UnreadableRowError) else str(error)
            if line := _repeated.line_if_due(f"an answer from the record broke off: {error}", reason):
                _log.warning("%s", line)


async def _no_parts() -> AsyncIterator[bytes]:
    yield b""


async def answer_in_parts(
    context: Context,
    query: Callable[[Reader], Iterator[bytes]],
    media_type: str,
    headers: Mapping[str, str] | None = None,
) -> StreamingResponse:
    """Return the answer whose parts a query gives, at least one; raises RecordAwayError if that cannot be read.

    A reader of the record makes the parts. So an answer takes no more memory than two of them, however long it is.
    """
    parts = context.recorder.readers.read_parts(query)
    first = await anext(parts)

    async def give() -> AsyncIterator[bytes]:
        yield first
        async for part in parts:
            yield part

    return _Parts(give(), headers=headers, media_type=media_type)
