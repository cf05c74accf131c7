"""Sends the descriptions of the surfaces for Home Assistant, and sends one again when its surface has other axes."""

import asyncio
from collections.abc import Sequence

from beamtouch_service.outputs.mqtt import discovery
from beamtouch_service.outputs.mqtt.connection import Connection
from beamtouch_service.outputs.mqtt.messages import JSON, Topics
from beamtouch_service.surfaces.surface import Surface

LOOK_S = 1.0
"""Pause between two looks at the surfaces."""


class DescriptionSender:
    """Sends the descriptions of these surfaces."""

    def __init__(self, topics: Topics, surfaces: Sequence[Surface]) -> None:
        self._topics = topics
        self._surfaces = {discovery.topic(topics, one.name): one for one in surfaces}
        self._axes: dict[str, tuple[str, ...]] = {}
        """Topic -> the axes that its description has."""
        self.texts: dict[str, bytes] = {}
        """Topic -> description."""
        self.update()

    def update(self) -> list[str]:
        """Describe the surfaces that have other axes than before; return the topics of these."""
        changed = [topic for topic, surface in self._surfaces.items() if surface.axes != self._axes.get(topic)]
        for topic in changed:
            surface = self._surfaces[topic]
            self._axes[topic], self.texts[topic] = surface.axes, discovery.description(self._topics, surface)
        return changed

    async def send_all(self, connection: Connection) -> None:
        """Send all descriptions; raises BrokerError if the broker refuses one, or the connection is lost."""
        for topic, text in self.texts.items():
            await connection.require_kept(topic, text, JSON)

    async def run(self, connection: Connection) -> None:
        """Send what changes; raises BrokerError when the connection is lost."""
        while True:
            before = dict(self.texts)
            for topic in self.update():
                if gone := discovery.find_gone(before[topic], self.texts[topic]):
                    await connection.require_kept(topic, discovery.without(self.texts[topic], gone), JSON)
                await connection.require_kept(topic, self.texts[topic], JSON)
            await asyncio.sleep(LOOK_S)
