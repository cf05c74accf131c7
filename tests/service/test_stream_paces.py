"""The pace of a stream of states, and that a client that leaves makes room."""

import asyncio
import json
from collections.abc import MutableMapping
from typing import Any

from beamtouch_service.api.stream import StateStream
from service.bench import Bench, Row, parsed
from service.event_story import RESTING, TOUCHING


def test_a_change_between_two_turns_waits_for_the_next_one(bench: Bench) -> None:
    (surface,) = bench.app.context.registry
    streams, sent, left = bench.app.context.streams, list[dict[str, Any]](), asyncio.Event()

    async def receive() -> dict[str, str]:
        await left.wait()
        return {"type": "http.disconnect"}

    async def send(message: MutableMapping[str, Any]) -> None:
        for line in message.get("body", b"").decode().splitlines():
            if line.startswith("data: "):
                sent.append(json.loads(line.removeprefix("data: ")))

    async def take(sequence: int, *rows: Row) -> None:
        surface.receive(parsed(*rows, sequence=sequence), bench.now_s)
        for _ in range(20):
            await asyncio.sleep(0)

    async def follow() -> None:
        await take(1, RESTING)
        stream = StateStream(bench.app.context, surface, 5.0)
        serving = asyncio.ensure_future(stream({"type": "http", "asgi": {"spec_version": "2.3"}}, receive, send))
        await take(2, RESTING)
        await take(3, TOUCHING)
        bench.now_s += 5.0
        await take(4, RESTING)
        assert streams.open == 1
        left.set()
        await serving

    asyncio.run(follow())
    assert [one["sequence"] for one in sent] == [2, 4]
    assert streams.open == 0
