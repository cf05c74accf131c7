"""Sends contacts. None of them waits: a contact is read once the broker has just answered, and is written at once.

So a broker that is slow or frozen gets no contact, and finds none in its buffers when it goes on.
"""

import asyncio

from paho.mqtt.properties import Properties

from beamtouch_service.api import errors
from beamtouch_service.api.context import Context
from beamtouch_service.outputs.mqtt.connection import Connection
from beamtouch_service.outputs.mqtt.counts import MqttCounts
from beamtouch_service.outputs.mqtt.messages import JSON, expiry_s, properties
from beamtouch_service.outputs.mqtt.pace import Pace
from beamtouch_service.outputs.mqtt.topics import Topics
from beamtouch_service.problems import MEDIA_TYPE, ProblemError
from beamtouch_service.surfaces.surface import Surface


class ContactSender:
    """Sends the contacts of all surfaces."""

    def __init__(self, context: Context, topics: Topics, max_rate_hz: float, counts: MqttCounts) -> None:
        self._context = context
        self._topics = topics
        self._max_rate_hz = max_rate_hz
        self._counts = counts
        self._properties = {surface.name: _properties(surface) for surface in context.registry}

    async def run(self, connection: Connection) -> None:
        """Send contacts over a connection; raises MqttError when it is lost."""
        pace, news, clock = Pace(self._context.registry, self._max_rate_hz), asyncio.Event(), self._context.clock

        def note(surface: Surface) -> None:
            if not news.is_set() and pace.has_news(surface, clock()):
                news.set()

        for surface in self._context.registry:
            surface.on_fresh = note
        while True:
            await _wait(news, pace.wait_s(clock()))
            news.clear()
            due = pace.due(clock())
            if due:
                await self._confirm(connection, due)
                # Those that have come to be due meanwhile, too.
                due = pace.due(clock())
                pace.sent(due, clock())
                for surface in due:
                    await self._send(connection, surface)

    async def _confirm(self, connection: Connection, due: list[Surface]) -> None:
        """Wait for the broker, and count the contacts that became too old meanwhile."""
        clock, is_confirmed = self._context.clock, False
        limits_s = [
            surface.newest.acquired_s + surface.stale_ms / 1e3
            for surface in due
            if surface.newest and not surface.is_stale(clock())
        ]
        try:
            await connection.confirm()
            is_confirmed = True
        finally:
            now_s = clock()
            self._counts.dropped.inc(sum(not is_confirmed or limit_s < now_s for limit_s in limits_s))

    async def _send(self, connection: Connection, surface: Surface) -> None:
        now_s = self._context.clock()
        of_contact, of_problem = self._properties[surface.name]
        try:
            text, kind = surface.contact(now_s).model_dump_json().encode(), of_contact
        except ProblemError as error:
            text, kind = errors.encoded(error.problem), of_problem
        age_s = surface.newest.age_ms(now_s) / 1e3 if surface.newest and kind is of_contact else 0.0
        # It is written at once. If the socket is full, it may wait until it is too old; then the connection is cut.
        left_s = surface.stale_ms / 1e3 - age_s
        await connection.publish(self._topics.contact(surface.name), text, properties=kind, timeout=left_s)
        self._counts.contacts.inc()
        # Other work goes on between two messages.
        await asyncio.sleep(0)


def _properties(surface: Surface) -> tuple[Properties, Properties]:
    """Return the properties of a contact, and of a problem in its place."""
    kept_s = expiry_s(surface.stale_ms)
    return properties(JSON, kept_s), properties(MEDIA_TYPE, kept_s)


async def _wait(news: asyncio.Event, seconds: float) -> None:
    try:
        async with asyncio.timeout(seconds):
            await news.wait()
    except TimeoutError:
        return
