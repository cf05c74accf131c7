"""Events over OPC UA while the record is away."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from asyncua import Server

from beamtouch_service.outputs.opcua.events import EventSender
from beamtouch_service.sections import EventsSection
from service.bench import Bench, surface_of


def test_a_record_that_is_away_is_asked_again_only_after_a_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db"))
    assert bench.get("/events").status_code == 200
    for one in tmp_path.glob("events.db*"):
        one.write_bytes(b"no database" * 4096)
    assert bench.get("/events").status_code == 503
    recorder, tries = bench.app.context.recorder, list[int]()
    ask: Callable[..., Awaitable[Any]] = recorder.wait_for_finished

    async def counted(*given: object) -> object:
        tries.append(1)
        return await ask(*given)

    monkeypatch.setattr(recorder, "wait_for_finished", counted)

    async def send() -> None:
        server = Server()
        await server.init()
        with suppress(TimeoutError):
            async with asyncio.timeout(0.3):
                await EventSender(server, recorder, {}).run()

    assert bench.event_loop is not None
    bench.event_loop.call(send)
    assert len(tries) == 1
