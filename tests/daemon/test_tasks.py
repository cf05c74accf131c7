"""Tasks that go on after an unexpected error, and the line of the log about it."""

import asyncio
import json
import logging

import pytest

from beamtouch_common.log import JsonFormatter
from beamtouch_daemon import tasks

pytestmark = pytest.mark.anyio


async def test_work_starts_again_after_an_unexpected_error_which_is_logged_whole(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(tasks, "RESTART_S", 0.01)
    attempts = 0

    async def work() -> None:
        nonlocal attempts
        attempts += 1
        if attempts < 3:
            message = "no such thing"
            raise LookupError(message)

    with caplog.at_level(logging.ERROR):
        async with asyncio.timeout(60):
            await tasks.keep_going("bench", work)
    assert attempts == 3
    lines = [json.loads(JsonFormatter().format(record)) for record in caplog.records]
    assert [line["message"] for line in lines] == ["bench: unexpected error; restarting"] * 2
    assert all(line["traceback"].endswith("LookupError: no such thing") for line in lines)
