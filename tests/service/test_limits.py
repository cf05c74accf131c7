"""Limits on the time for a body."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from starlette.requests import Request

from beamtouch_service.api.samples import read_body
from beamtouch_service.problems import Kind, ProblemError

if TYPE_CHECKING:
    from starlette.types import Message


@pytest.mark.anyio
async def test_a_body_that_trickles_is_given_up() -> None:
    async def receive() -> Message:
        await asyncio.sleep(0.01)
        return {"type": "http.request", "body": b" ", "more_body": True}

    with pytest.raises(ProblemError) as caught:
        await read_body(Request({"type": "http", "headers": []}, receive), limit_s=0.1)
    assert caught.value.problem.kind is Kind.TOO_SLOW
    assert caught.value.headers == {"Connection": "close"}
