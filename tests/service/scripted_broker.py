"""Connections to a broker that do what a test has planned, and the clock that they move."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from beamtouch_service.outputs.mqtt.failures import BrokerError

if TYPE_CHECKING:
    from beamtouch_service.outputs.mqtt.messages import Kept


@dataclass
class Clock:
    """A clock that stands still until it is told otherwise."""

    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s


@dataclass
class Scripted:
    """A connection that fails after so long when it is opened, or is lost after so long once it is open.

    Requests that are named in `refused`, such as "subscribe hall/status", fail with the error there.
    """

    clock: Clock = field(default_factory=Clock)
    opening_s: float = 0.0
    failure: Exception | None = None
    open_s: float = 0.0
    loss: Exception = field(default_factory=lambda: BrokerError("the connection is lost"))
    refused: dict[str, Exception] = field(default_factory=dict)
    kept: list[Kept] = field(default_factory=list)
    """What the broker has sent by the time of its answer to `confirm`."""
    owner: str = "one"
    said: list[str] = field(default_factory=list)
    """What was asked of it."""
    is_closed: bool = False

    def __post_init__(self) -> None:
        self.received = asyncio.Queue[Any]()

    async def open(self) -> None:
        self.clock.now_s += self.opening_s
        if self.failure:
            raise self.failure

    async def watch(self) -> None:
        self.clock.now_s += self.open_s
        raise self.loss

    async def confirm(self) -> None:
        self._ask("confirm")
        for one in self.kept:
            self.received.put_nowait(one)

    async def subscribe(self, topic: str) -> None:
        self._ask(f"subscribe {topic}")

    async def keep(self, topic: str, text: bytes, content_type: str) -> None:
        self._ask(f"keep {topic}", f"{text.decode()} {content_type}")

    async def require_kept(self, topic: str, text: bytes, content_type: str) -> None:
        await self.keep(topic, text, content_type)

    def close(self) -> None:
        self.is_closed = True

    def _ask(self, request: str, more: str = "") -> None:
        self.said.append(f"{request} {more}".strip())
        if request in self.refused:
            raise self.refused[request]
