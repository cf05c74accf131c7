"""Finished events of the record as OPC UA events. They reach the clients that are there; `GET /events` has all."""

import asyncio
from collections.abc import Iterable, Mapping
from datetime import datetime

from asyncua import Server, ua
from asyncua.server.event_generator import EventGenerator

from beamtouch_common.outline import BEAM_AXES
from beamtouch_service.outputs.opcua.values import variable_of
from beamtouch_service.record import Due, Numbered, RecordAwayError, Recorder, Transactions, event_fields_of

RETRY_S = 1.0
"""Pause before the record is read again, after it was away."""
AT_ONCE = 10
"""Events that are read together."""
DESTINATION = "opcua"


class EventSender:
    """Sends the finished events of all surfaces."""

    def __init__(
        self,
        server: Server,
        recorder: Recorder,
        objects: Mapping[str, ua.NodeId],
        axes: Iterable[tuple[str, ...]] = (BEAM_AXES,),
    ) -> None:
        """Prepare to send.

        Parameters
        ----------
        objects : surface -> its object, which emits the events
        axes : the axes of surfaces; an event has the places of all, empty where its own surface has no such axis
        """
        self._server, self._recorder, self._objects = server, recorder, objects
        fields = {field.name: field for each in axes for field in event_fields_of(each)}
        self._properties = {name: variable_of(field) for name, field in fields.items()}
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
        properties = [(name, one.kind) for name, one in self._properties.items()]
        kind = await self._server.create_custom_event_type(index, "ContactEventType", properties=properties)
        for name, node in self._objects.items():
            self._generators[name] = await self._server.get_event_generator(kind, node)
            await self._server.nodes.server.add_reference(node, ua.ObjectIds.HasNotifier)
            await asyncio.sleep(0)  # requests have a turn

    async def _send(self, due: Due) -> None:
        generator = self._generators.get(due.event.surface)
        if generator is None:  # no longer configured
            return
        numbered, sent = Numbered(due.number, due.event), generator.event
        for name, one in self._properties.items():
            setattr(sent, name, one.of(numbered))
        sent.emitting_node = self._objects[due.event.surface]
        await generator.trigger(
            time_attr=datetime.fromisoformat(sent.lifted_at or sent.touched_at),
            message=f"{sent.kind} on {sent.surface}, {sent.dwell_ms:.0f} ms",
        )
        # Clients that want the events of all surfaces listen at the Server object. The library only serves the emitter.
        sent.emitting_node = self._server.nodes.server.nodeid
        await self._server.iserver.subscription_service.trigger_event(sent)


def _find_due(transactions: Transactions) -> tuple[list[Due], int]:
    return transactions.due(DESTINATION, AT_ONCE, from_start=False)
