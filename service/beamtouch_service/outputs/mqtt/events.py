"""Sends finished events, from the record. What the broker has not acknowledged is sent again."""

import asyncio
import logging
from contextlib import suppress
from functools import partial

from prometheus_client import Counter

from beamtouch_service.api.context import Context
from beamtouch_service.outputs.mqtt.connection import REFUSED_RETRY_S, WINDOW, Connection
from beamtouch_service.outputs.mqtt.failures import RefusedError
from beamtouch_service.outputs.mqtt.messages import JSON, Topics, properties
from beamtouch_service.outputs.mqtt.section import MqttSection
from beamtouch_service.record import Due, Numbered, RecordAwayError, Transactions, encode_event

RETRY_S = 1.0
"""Pause before the same events are sent again, or read again."""
COUNT_S = 5.0
"""Longest wait for the record before a connection. Contacts do not need it."""
RETURN_S = 10.0
"""After an outage, subscribers have this long to return: until then, an event that none of them gets is sent again."""

_log = logging.getLogger(__name__)


class EventSender:
    """Sends the events of all surfaces to one destination."""

    def __init__(self, context: Context, section: MqttSection, topics: Topics, sent: Counter) -> None:
        self._recorder = context.recorder
        self._destination = f"mqtt://{section.host}:{section.broker_port}/{section.prefix}"
        self._from_start = section.send_recorded_events
        """True if a new destination gets all events on record, or those from now on."""
        self._topics = topics
        self._sent = sent
        """Counts the events that the broker acknowledged."""
        words = "Finished events that the MQTT broker has yet to acknowledge."
        self._pending = context.counts.gauge("mqtt_events_pending", words)
        self._resume_s = float("-inf")
        """Time of the next attempt after a refusal, also over the next connection [s, of the loop]."""

    async def count_pending(self) -> None:
        """Count the events that have yet to be acknowledged, unless the record takes long."""
        with suppress(TimeoutError, RecordAwayError):  # the log has it
            async with asyncio.timeout(COUNT_S):
                await self._recorder.write(partial(self._find_due, limit=0))

    async def run(self, connection: Connection) -> None:
        """Send events over a connection; raises BrokerError when it is lost."""
        loop = asyncio.get_running_loop()
        settled_s = loop.time() + RETURN_S
        while True:
            await asyncio.sleep(self._resume_s - loop.time())
            try:
                due = await self._recorder.wait_for_finished(partial(self._find_due, limit=WINDOW))
                has_listeners = await self._send(connection, due)
            except RefusedError as error:
                self._resume_s = loop.time() + REFUSED_RETRY_S
                words = "the MQTT broker refuses events (%s); allow this user to write to %s"
                _log.warning(words, error, self._topics.event("+"))
                continue
            except RecordAwayError:  # the log has it
                await asyncio.sleep(RETRY_S)
                continue
            if has_listeners or loop.time() > settled_s:
                await self._acknowledge(due)
            else:
                await asyncio.sleep(RETRY_S)

    def _find_due(self, transactions: Transactions, limit: int) -> tuple[list[Due], int]:
        """Return at most `limit` events to send, and the count of all, in the thread of the record."""
        due, count = transactions.due(self._destination, limit, from_start=self._from_start)
        self._pending.set(count)
        return due, count

    async def _send(self, connection: Connection, due: list[Due]) -> bool:
        """Send events, and return whether the broker had a subscriber for each."""
        messages = [
            (
                self._topics.event(delivery.event.surface),
                encode_event(Numbered(delivery.number, delivery.event)),
            )
            for delivery in due
        ]
        return await connection.tell(*messages, properties=properties(JSON))

    async def _acknowledge(self, due: list[Due]) -> None:
        self._sent.inc(len(due))
        with suppress(RecordAwayError):  # they are sent again
            await self._recorder.write(lambda transactions: transactions.acknowledge(due))
