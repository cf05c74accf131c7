"""Limits on the time for a body, and on log lines."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

import pytest
from starlette.requests import Request

from beamtouch_service.api.samples import read_body
from beamtouch_service.limits import Seldom, SeldomFilter
from beamtouch_service.problems import Kind, ProblemError

if TYPE_CHECKING:
    from starlette.types import Message


def test_what_happens_often_is_spoken_of_once_a_minute_with_its_count() -> None:
    seldom = Seldom(every_s=60)

    assert [seldom.due("a", at_s) for at_s in (0.0, 1.0, 59.9, 60.0, 61.0)] == [1, 0, 0, 3, 0]
    assert seldom.due("b", 61.0) == 1


def test_made_up_kinds_of_messages_do_not_fill_the_memory_of_those_that_were_written() -> None:
    seldom = Seldom(every_s=60)
    for number in range(100):
        assert seldom.due(f"kind {number}", 0.0) == 1

    assert seldom.due("kind 0", 1.0) == 0
    assert seldom.due("one too many", 1.0) == 1
    assert seldom.due("kind 0", 1.0) == 1  # forgotten with all others, so it is written again


def test_a_logger_repeats_itself_once_a_minute() -> None:
    now_s = [0.0]
    limited = SeldomFilter(lambda: now_s[0])
    record = logging.makeLogRecord({"msg": "Invalid HTTP request received."})

    assert [limited.filter(record) for _ in range(3)] == [True, False, False]
    now_s[0] = 60.0
    assert limited.filter(record)


@pytest.mark.anyio
async def test_a_body_that_trickles_is_given_up() -> None:
    async def receive() -> Message:
        await asyncio.sleep(0.01)
        return {"type": "http.request", "body": b" ", "more_body": True}

    with pytest.raises(ProblemError) as caught:
        await read_body(Request({"type": "http", "headers": []}, receive), limit_s=0.1)
    assert caught.value.problem.kind is Kind.TOO_SLOW
    assert caught.value.headers == {"Connection": "close"}
