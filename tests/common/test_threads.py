"""Calls that threads run in the order in which they come."""

import threading

import pytest

from beamtouch_common.threads import Workers

pytestmark = pytest.mark.anyio


async def test_a_call_that_is_cancelled_before_its_turn_does_not_run() -> None:
    workers, gate, ran = Workers("one"), threading.Event(), list[str]()
    first, second = workers.run(gate.wait), workers.run(lambda: ran.append("second"))
    second.cancel()
    gate.set()
    await first
    await workers.run(lambda: ran.append("third"))
    workers.end()
    assert ran == ["third"]
