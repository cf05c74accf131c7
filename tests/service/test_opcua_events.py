"""Events over OPC UA while the record is away."""

import asyncio
from contextlib import suppress
from typing import Any, cast

import pytest

from beamtouch_service.events.database import EventsAwayError
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.outputs.opcua.events import EventSender

pytestmark = pytest.mark.anyio


class Away:
    """A recorder whose record is away, and how often it is asked."""

    tries = 0

    async def wait_for_finished(self, _call: object) -> None:
        self.tries += 1
        await asyncio.sleep(0)
        raise EventsAwayError("the record of events is away")


async def test_a_record_that_is_away_is_asked_again_only_after_a_pause() -> None:
    away = Away()
    sender = EventSender(cast("Any", None), cast(Recorder, away), asyncio.get_running_loop(), {})
    with suppress(TimeoutError):
        async with asyncio.timeout(0.3):
            await sender._take()
    assert away.tries == 1
