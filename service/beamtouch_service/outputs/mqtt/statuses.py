"""Sends the status of each surface when it changes; the broker keeps the last one for subscribers to come."""

import asyncio
import json
import logging
from contextlib import suppress

from beamtouch_service.api.context import Context
from beamtouch_service.outputs.mqtt.connection import Connection, RefusedError
from beamtouch_service.outputs.mqtt.messages import JSON, properties
from beamtouch_service.outputs.mqtt.topics import READY, Topics
from beamtouch_service.surfaces.surface import Surface

LOOK_S = 1.0
"""Pause between two looks at the surfaces."""
REFUSED_RETRY_S = 30.0
"""Pause after the broker refused a status: someone has to change its rights first."""
_log = logging.getLogger("beamtouch.service.mqtt")


def status_of(surface: Surface, now_s: float) -> bytes:
    """Return what `GET /health/ready?health=true` says of a surface at `now_s` [s, monotonic], in one word."""
    problem = surface.unready(now_s, healthy=True)
    channels = problem.channels if problem else []
    return json.dumps(
        {"surface": surface.name, "status": problem.kind.slug if problem else READY, "channels": channels}
    ).encode()


class StatusSender:
    """Sends the statuses of all surfaces."""

    def __init__(self, context: Context, topics: Topics) -> None:
        self._context = context
        self._topics = topics
        self._resume_s = float("-inf")
        """When to try again after a refusal [s, of the loop]."""

    async def run(self, connection: Connection) -> None:
        """Send statuses over a connection: all at first, then those that change; raises MqttError when it is lost."""
        sent: dict[str, bytes] = {}
        while True:
            await asyncio.sleep(self._resume_s - asyncio.get_running_loop().time())
            for surface in self._context.registry:
                status = status_of(surface, self._context.clock())
                if status == sent.get(surface.name):
                    continue
                await self._send(connection, self._topics.surface_status(surface.name), status)
                if connection.refusal is not None:
                    break
                sent[surface.name] = status
            await asyncio.sleep(LOOK_S)

    async def _send(self, connection: Connection, topic: str, status: bytes) -> None:
        """Send a status. If the broker refuses it, none is sent for a while, also over the next connection."""
        async with connection.telling:
            try:
                with suppress(RefusedError):
                    await connection.tell((topic, status), content_type=properties(JSON), retain=True)
            finally:
                if connection.refusal is not None:
                    self._resume_s = asyncio.get_running_loop().time() + REFUSED_RETRY_S
                    words = "the MQTT broker refuses messages to %s (%s); allow this user to write there"
                    _log.warning(words, topic, connection.refusal)
