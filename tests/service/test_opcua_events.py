"""Events over OPC UA while the record is away."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import pytest
from asyncua import Server

from beamtouch_service.outputs.opcua.events import EventSender
from beamtouch_service.record import Begin, Due, End, Event, EventKind, Recorder
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


class Finished:
    """A record with many finished events, which are all there is."""

    def __init__(self, count: int) -> None:
        event = Event("press-7", "model", "boot-0001", 1, 2, 1, 2, EventKind.CONTACT, Begin.TOUCH, End.LIFT)
        self._due = [Due(number, number, event) for number in range(1, count + 1)]
        self.is_empty = False
        self.is_sent = asyncio.Event()

    async def wait_for_finished(self, _: object) -> list[Due]:
        if not self._due:
            self.is_sent.set()
            await asyncio.Event().wait()
        self.is_empty = True
        return self._due

    async def write(self, _: object) -> None:
        self._due = []


def test_others_have_a_turn_between_two_events_that_are_sent() -> None:
    async def send(count: int) -> int:
        server = Server()
        await server.init()
        space = await server.register_namespace("urn:press")
        press = await server.nodes.objects.add_object(space, "press-7")
        record, turns = Finished(count), 0
        sender = asyncio.ensure_future(EventSender(server, cast("Recorder", record), {"press-7": press.nodeid}).run())
        sending = asyncio.ensure_future(record.is_sent.wait())
        while not sending.done():
            await asyncio.sleep(0)
            turns += record.is_empty
        sender.cancel()
        return turns

    assert asyncio.run(send(50)) >= 50
