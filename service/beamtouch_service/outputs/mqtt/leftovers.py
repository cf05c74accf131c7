"""Removes what the broker keeps of this service and the configuration no longer has: surfaces, zones, descriptions.

The broker itself is the memory: each message that it keeps for a service states its owner. So a service finds what it
once announced, whatever became of its files, and leaves alone what is of other services.
"""

import asyncio
import logging
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress

from beamtouch_service.outputs.mqtt import discovery
from beamtouch_service.outputs.mqtt.connection import ANSWER_S, Connection
from beamtouch_service.outputs.mqtt.failures import BrokerError, RefusedError
from beamtouch_service.outputs.mqtt.messages import JSON, ONLINE, Kept, Topics

MOST_LOSSES = 2
"""Then the service no longer asks for what costs it the connection, and no longer removes it."""
_ENDS = "it ends the connection"

_log = logging.getLogger(__name__)


class Leftovers:
    """Messages that the broker keeps below one prefix and that should not be there."""

    def __init__(self, topics: Topics, surfaces: list[str], descriptions: Mapping[str, bytes], where: str) -> None:
        """Take the surfaces that there are, their descriptions by topic, and what the log calls the broker."""
        self._topics = topics
        self._descriptions = descriptions
        self._wanted = {topics.status, *map(topics.surface_status, surfaces), *descriptions}
        self._where = where
        self._is_readable = False
        """True if the broker lets this service read its own messages."""
        self._losses = Counter[str]()
        """Topic -> losses of the connection in a row over its subscription or its removal."""
        self._said: set[str] = set()
        """Topics that the log has, and those that the broker refused to change."""

    async def begin(self, connection: Connection) -> None:
        """Subscribe, and remove what is there at once; raises BrokerError if the connection is lost.

        To be called before the descriptions are sent: they take the place of those that say which zones there were.
        """
        for topic in (self._topics.status, self._topics.surface_status("+"), discovery.topic(self._topics, "+")):
            await self._subscribe(connection, topic)
        # Most brokers have sent what they keep before this answer.
        await connection.confirm()
        with suppress(asyncio.QueueEmpty):
            while True:
                await self._settle(connection, connection.received.get_nowait())

    async def run(self, connection: Connection) -> None:
        """Remove what comes later; raises BrokerError when the connection is lost."""
        if not self._is_readable:
            with suppress(TimeoutError):
                async with asyncio.timeout(ANSWER_S):
                    while not self._is_readable:
                        await self._settle(connection, await connection.received.get())
        if not self._is_readable:
            self._warn_unreadable(self._topics.status)
        while True:
            await self._settle(connection, await connection.received.get())

    async def _subscribe(self, connection: Connection, topic: str) -> None:
        if self._losses[topic] == MOST_LOSSES:
            return
        try:
            await connection.subscribe(topic)
            self._losses[topic] = 0
        except RefusedError as error:
            self._warn_unreadable(topic, f" ({error})")
        except BrokerError:
            if self._is_costly(topic):
                self._warn_unreadable(topic, f" ({_ENDS})")
            raise

    async def _settle(self, connection: Connection, message: Kept) -> None:
        """Compare a message with what is to be there."""
        topic, is_own = message.topic, message.owner == connection.owner
        self._is_readable |= is_own and topic == self._topics.status
        if not message.text or topic in self._said:
            return
        if topic not in self._wanted:
            if is_own:
                await self._put(connection, topic, b"")
                _log.info("MQTT broker %s: removed %s, which this configuration no longer has", self._where, topic)
        elif message.owner and not is_own and (message.is_new or message.text == ONLINE.encode()):
            self._said.add(topic)
            words = "MQTT broker %s: another service (%s) writes to %s, too; give each service a prefix of its own"
            _log.warning(words, self._where, message.owner, topic)
        elif is_own and topic in self._descriptions:
            described = self._descriptions[topic]
            if gone := discovery.find_gone(message.text, described):
                await self._put(connection, topic, discovery.without(described, gone))
                await self._put(connection, topic, described)

    async def _put(self, connection: Connection, topic: str, text: bytes) -> None:
        try:
            await connection.keep(topic, text, JSON)
            self._losses[topic] = 0
        except RefusedError as error:
            self._warn_unwritable(topic, str(error))
        except BrokerError:
            if self._is_costly(topic):
                self._warn_unwritable(topic, _ENDS)
            raise

    def _is_costly(self, topic: str) -> bool:
        """Count a loss over a topic, as some brokers end the connection; return whether it is to be left alone now."""
        self._losses[topic] += 1
        return self._losses[topic] == MOST_LOSSES

    def _warn_unwritable(self, topic: str, reason: str) -> None:
        self._said.add(topic)
        words = "MQTT broker %s: it refuses messages to %s (%s), which is of no surface any more; remove it there"
        _log.warning(words, self._where, topic, reason)

    def _warn_unreadable(self, topic: str, reason: str = "") -> None:
        # Without discovery, nobody may ever have had the right to read there.
        is_of_interest = self._descriptions or topic != discovery.topic(self._topics, "+")
        if is_of_interest and topic not in self._said:
            self._said.add(topic)
            words = "MQTT broker %s: this user may not read %s%s; allow it, or what you remove here stays there"
            _log.warning(words, self._where, topic, reason)
