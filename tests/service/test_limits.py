"""Limits on batches per second, on the time for a body, and on log lines."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

import pytest
from starlette.requests import Request

from beamtouch_service.api.samples import read_body
from beamtouch_service.limits import Bucket, Seldom, SeldomFilter
from beamtouch_service.problems import Kind, ProblemError
from beamtouch_service.surfaces.surface import Surface

if TYPE_CHECKING:
    from starlette.types import Message

    from service.conftest import Bench, MakeBatch


def test_a_bucket_gives_so_many_at_once_and_then_so_many_per_second() -> None:
    bucket = Bucket(per_s=4)

    assert [bucket.take(100.0) for _ in range(4)] == [0.0] * 4
    assert bucket.take(100.0) == pytest.approx(0.25)
    assert bucket.take(100.25) == 0.0
    assert bucket.take(100.25) > 0
    assert [bucket.take(1000.0) == 0.0 for _ in range(5)] == [True] * 4 + [False]


def test_a_bucket_of_less_than_one_per_second_gives_one() -> None:
    bucket = Bucket(per_s=0.5)

    assert (bucket.take(10.0), bucket.take(11.0), bucket.take(12.0)) == (0.0, 1.0, 0.0)


def test_too_many_batches_are_told_when_to_come_back_and_other_surfaces_are_not_concerned(
    make_bench: type[Bench], make_batch: MakeBatch
) -> None:
    bench = make_bench(Surface("press-7"), Surface("press-8"), max_batches_per_s=2)
    answers = [bench.post(make_batch(sequence=number)) for number in range(1, 4)]

    assert [answer.status_code for answer in answers] == [200, 200, 429]
    assert answers[2].json()["type"] == "urn:beamtouch:problem:too-many-requests"
    assert answers[2].headers["retry-after"] == "1"
    assert bench.post(make_batch(), path="/surfaces/press-8/samples").status_code == 200
    bench.now_s += 1
    assert bench.post(make_batch(sequence=3)).json()["accepted"] == 1


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
