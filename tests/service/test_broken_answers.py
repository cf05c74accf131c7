"""An answer that fails: before its begin it is a 500 in the form of all problems, and after it no other one begins."""

from collections.abc import AsyncIterator

import pytest
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.testclient import TestClient

from service.bench import Bench, kind


async def pieces() -> AsyncIterator[bytes]:
    yield b"begun"
    raise ZeroDivisionError("in a test")


async def break_off(_: Request) -> Response:
    return StreamingResponse(pieces())


async def fail(_: Request) -> Response:
    raise ZeroDivisionError("in a test")


def test_an_answer_that_fails_before_its_begin_is_an_internal_error(bench: Bench) -> None:
    bench.app.router.add_route("/fails", fail)
    answer = bench.get("/fails")
    assert (answer.status_code, kind(answer)) == (500, "internal")


def test_after_the_begin_of_an_answer_that_fails_no_other_one_begins(bench: Bench) -> None:
    bench.app.router.add_route("/breaks-off", break_off)
    with pytest.raises(ZeroDivisionError, match="in a test"):
        TestClient(bench.app).get("/breaks-off")
