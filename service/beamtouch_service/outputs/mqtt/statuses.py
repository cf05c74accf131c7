"""Sends the status of each surface when it changes; the broker keeps the last one for subscribers to come."""

import asyncio
import json
import logging

from beamtouch_service.api.context import Context
from beamtouch_service.outputs.mqtt.connection import REFUSED_RETRY_S, Connection
from beamtouch_service.outputs.mqtt.failures import RefusedError
from beamtouch_service.outputs.mqtt.messages import JSON, READY, Topics
from beamtouch_service.surfaces.surface import Surface

LOOK_S = 1.0
"""Pause between two looks at the surfaces."""
_log = logging.getLogger(__name__)


def status_of(surface: Surface, now_s: float) -> bytes:
    """Return what `GET /health/ready?health=true` says of a surface at `now_s` [s, monotonic], in one word."""
    problem = surface.find_fault(now_s)
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
        """Time of the next attempt after a refusal, also over the next connection [s, of the loop]."""

    async def run(self, connection: Connection) -> None:
        """Send statuses over a connection: all at first, then those that change; raises BrokerError when it is lost."""
        loop, sent = asyncio.get_running_loop(), dict[str, bytes]()
        while True:
            await asyncio.sleep(self._resume_s - loop.time())
            for surface in self._context.registry:
                status, topic = status_of(surface, self._context.clock()), self._topics.surface_status(surface.name)
                if status == sent.get(surface.name):
                    continue
                try:
                    await connection.keep(topic, status, JSON)
                except RefusedError as error:
                    self._resume_s = loop.time() + REFUSED_RETRY_S
                    words = "the MQTT broker refuses messages to %s (%s); allow this user to write there"
                    _log.warning(words, topic, error)
                    break
                sent[surface.name] = status
            await asyncio.sleep(LOOK_S)
