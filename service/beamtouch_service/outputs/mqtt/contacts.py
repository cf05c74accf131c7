"""Sends contacts. None of them waits: a contact is read once the broker has just answered, and is written at once.

So a broker that is slow or frozen gets no contact, and finds none in its buffers when it goes on.
"""

import asyncio

from prometheus_client import Counter

from beamtouch_service.api import errors
from beamtouch_service.api.context import Context
from beamtouch_service.outputs.mqtt.connection import Connection
from beamtouch_service.outputs.mqtt.messages import JSON, Topics, properties
from beamtouch_service.problems import MEDIA_TYPE
from beamtouch_service.surfaces import fields
from beamtouch_service.surfaces.pace import Pace
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.watch import Watch


class ContactSender:
    """Sends the contacts of all surfaces."""

    def __init__(self, context: Context, topics: Topics, max_rate_hz: float, sent: Counter) -> None:
        self._context = context
        self._topics = topics
        self._max_rate_hz = max_rate_hz
        self._sent = sent
        words = "Contacts that were due but not sent, because the MQTT broker did not answer before they were too old."
        self._dropped = context.counts.counter("mqtt_contacts_dropped", words)

    async def run(self, connection: Connection) -> None:
        """Send contacts over a connection; raises BrokerError when it is lost."""
        surfaces = list(self._context.registry)
        watch = Watch(surfaces, Pace(surfaces, 1 / self._max_rate_hz), self._context.clock)
        with watch.listening():
            while True:
                await watch.wait()
                if watch.due():
                    await self._confirm(connection, watch)
                    # Also those that have come to be due meanwhile.
                    for surface in watch.take_due():
                        await self._send(connection, surface)

    async def _confirm(self, connection: Connection, watch: Watch) -> None:
        """Wait for the broker, and count the contacts that are due, but became too old meanwhile."""
        begin_s, is_confirmed = self._context.clock(), False
        try:
            await connection.confirm()
            is_confirmed = True
        finally:
            now_s = self._context.clock()
            samples = [(surface.newest, surface.stale_ms / 1e3) for surface in watch.due()]
            limits_s = [newest.acquired_s + stale_s for newest, stale_s in samples if newest]
            self._dropped.inc(sum(begin_s <= limit_s and (not is_confirmed or limit_s < now_s) for limit_s in limits_s))

    async def _send(self, connection: Connection, surface: Surface) -> None:
        now_s, limit_s = self._context.clock(), surface.stale_ms / 1e3
        view = surface.view(now_s)
        if view.problem:
            text, content_type, age_s = errors.encode(view.problem), MEDIA_TYPE, 0.0
        else:
            text, content_type, age_s = fields.encode(view), JSON, (view.age_ms or 0.0) / 1e3
        topic = self._topics.contact(surface.name)
        await connection.send(topic, text, properties(content_type, surface.stale_ms), limit_s - age_s)
        self._sent.inc()
        # Other work goes on between two messages.
        await asyncio.sleep(0)
