"""Finished events of the record as OPC UA events. They reach the clients that are there; `GET /events` has all."""

import asyncio
import json
from collections.abc import Mapping
from datetime import datetime

from asyncua import Server, ua
from asyncua.server.event_generator import EventGenerator

from beamtouch_service.api import events as event_answers
from beamtouch_service.record import Due, RecordAwayError, Recorder, Transactions

RETRY_S = 1.0
"""Pause before the record is read again, after it was away."""
AT_ONCE = 10
"""Events that are read together."""
DESTINATION = "opcua"
FIELDS = {
    "id": ua.VariantType.UInt64,
    "surface": ua.VariantType.String,
    "kind": ua.VariantType.String,
    "touched_at": ua.VariantType.String,
    "lifted_at": ua.VariantType.String,
    "begin": ua.VariantType.String,
    "end": ua.VariantType.String,
    "dwell_ms": ua.VariantType.Double,
    "mean_position_mm": ua.VariantType.Double,
    "mean_position_low_mm": ua.VariantType.Double,
    "mean_position_high_mm": ua.VariantType.Double,
    "min_position_mm": ua.VariantType.Double,
    "max_position_mm": ua.VariantType.Double,
    "mean_force_n": ua.VariantType.Double,
    "mean_force_low_n": ua.VariantType.Double,
    "mean_force_high_n": ua.VariantType.Double,
    "peak_force_n": ua.VariantType.Double,
    "peak_force_low_n": ua.VariantType.Double,
    "peak_force_high_n": ua.VariantType.Double,
    "peak_position_mm": ua.VariantType.Double,
    "samples": ua.VariantType.UInt32,
    "unsteady_samples": ua.VariantType.UInt32,
    "unsteady": ua.VariantType.Boolean,
    "quality": ua.VariantType.String,
    "model": ua.VariantType.String,
    "zones": ua.VariantType.String,
}
"""The fields of an event beside those that each OPC UA event has, with the names and meanings of `GET /events`; `zones`
is JSON, as OPC UA has no type for it."""


class EventSender:
    """Sends the finished events of all surfaces."""

    def __init__(self, server: Server, recorder: Recorder, objects: Mapping[str, ua.NodeId]) -> None:
        """`objects`: surface -> its object, which emits the events."""
        self._server, self._recorder, self._objects = server, recorder, objects
        self._generators: dict[str, EventGenerator] = {}
        self._sent: list[Due] = []
        """Events that were sent, and that the record does not know to be."""

    async def run(self) -> None:
        """Send events until cancelled. After an error, this goes on with the event that was not sent."""
        while True:
            try:
                await self._acknowledge()
                finished = await self._recorder.wait_for_finished(_find_due)
            except RecordAwayError:  # the log has it
                await asyncio.sleep(RETRY_S)
                continue
            for due in finished:
                await self._send(due)
                self._sent.append(due)
                await asyncio.sleep(0)  # the library gives others no turn between two events

    async def _acknowledge(self) -> None:
        """Tell the record which events were sent: nobody acknowledges them."""
        if sent := self._sent:
            await self._recorder.write(lambda transactions: transactions.acknowledge(sent))
            self._sent = []

    async def describe(self) -> None:
        """Make the type of the events, and name who emits them. This comes first, and once."""
        index = next(iter(self._objects.values())).NamespaceIndex if self._objects else 0
        kind = await self._server.create_custom_event_type(index, "ContactEventType", properties=list(FIELDS.items()))
        for name, node in self._objects.items():
            self._generators[name] = await self._server.get_event_generator(kind, node)
            await self._server.nodes.server.add_reference(node, ua.ObjectIds.HasNotifier)
            await asyncio.sleep(0)  # requests have a turn

    async def _send(self, due: Due) -> None:
        event = event_answers.event(due.number, due.event)
        generator = self._generators.get(event.surface)
        if generator is None:  # no longer configured
            return
        sent = generator.event
        for name, kind in FIELDS.items():
            value = getattr(event, name, None)  # a plate has no `mean_position_mm`
            setattr(sent, name, str(value) if kind is ua.VariantType.String and value else value)
        sent.zones = json.dumps(event.zones)
        sent.emitting_node = self._objects[event.surface]
        await generator.trigger(
            time_attr=datetime.fromisoformat(event.lifted_at or event.touched_at),
            message=f"{event.kind} on {event.surface}, {event.dwell_ms:.0f} ms",
        )
        # Clients that want the events of all surfaces listen at the Server object. The library only serves the emitter.
        sent.emitting_node = self._server.nodes.server.nodeid
        await self._server.iserver.subscription_service.trigger_event(sent)


def _find_due(transactions: Transactions) -> list[Due]:
    due, _ = transactions.due(DESTINATION, AT_ONCE, from_start=False)
    return due
