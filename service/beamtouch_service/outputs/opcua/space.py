"""The nodes of surfaces, what their variables answer, and when subscribers are told.

Nothing is stored: whoever reads a variable, or begins to subscribe to it, gets the contact of that moment.
"""

import asyncio
from datetime import UTC, datetime
from typing import Self

from asyncua import Node, Server, ua
from asyncua.common.callback import Callback

from beamtouch_service.api.context import Context
from beamtouch_service.outputs.opcua.values import Variable, values, variables_of
from beamtouch_service.surfaces.pace import Pace
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.watch import Watch

NAMESPACE = "urn:beamtouch"
"""The namespace of all nodes; a node is `NAME` or `NAME/variable`: no name of a surface has a slash."""


LOOK_S = 1.0
"""Time between two looks at the axes of the surfaces."""
_GONE = ua.DataValue(ua.Variant(None, ua.VariantType.Null), ua.StatusCode(ua.StatusCodes.BadConfigurationError))
"""A variable that its surface has no longer."""


class OtherAxesError(Exception):
    """A surface has a model with other axes than before, so that it has other variables."""


class _Told(ua.DataValue):  # type: ignore[misc]  # mypy skips the types of the library
    """A value that never changes. Of others, the library makes a copy for each subscriber, which costs most of all."""

    def __deepcopy__(self, _memo: object) -> Self:
        return self


class Space:
    """The nodes of all surfaces."""

    def __init__(self, server: Server, context: Context) -> None:
        self._server, self._context = server, context
        self.objects: dict[str, ua.NodeId] = {}
        """Surface -> its object."""
        self._variables: dict[ua.NodeId, tuple[Surface, str]] = {}
        """Variable -> its surface, and its name there."""
        self.axes: dict[str, tuple[str, ...]] = {}
        """Surface -> its axes when its variables were made."""
        self._names: dict[str, list[str]] = {}
        """Surface -> its variables."""
        self._looks: dict[str, dict[str, ua.DataValue]] = {}
        """Surface -> name -> value, of this turn of the event loop."""
        self._subscribed: dict[str, Surface] = {}
        self._told: dict[ua.NodeId, ua.DataValue] = {}
        """Variable -> what each of its subscribers has; without an entry, one of them may have something else."""
        self._is_changed = asyncio.Event()
        """Set when somebody has subscribed to another surface."""
        self._watch: Watch | None = None

    async def build(self) -> None:
        """Make an object for each surface, with its variables."""
        index = await self._server.register_namespace(NAMESPACE)
        top = self._server.get_objects_node()
        for surface in self._context.registry:
            node = await top.add_object(ua.NodeId(surface.name, index), ua.QualifiedName(surface.name, index))
            self.objects[surface.name] = node.nodeid
            variables = variables_of(surface)
            self.axes[surface.name], self._names[surface.name] = surface.axes, list(variables)
            for name, variable in variables.items():
                await self._add(surface, name, variable, node)
                await asyncio.sleep(0)  # requests have a turn

    async def _add(self, surface: Surface, name: str, variable: Variable, node: Node) -> None:
        """Add a variable to the object of its surface."""
        index = node.nodeid.NamespaceIndex
        nodeid, none = ua.NodeId(f"{surface.name}/{name}", index), ua.Variant(None, ua.VariantType.Null)
        kind = ua.NodeId(getattr(ua.ObjectIds, variable.kind.name))
        added = await node.add_variable(nodeid, ua.QualifiedName(name, index), none, datatype=kind)
        text = ua.LocalizedText(variable.meaning)
        await added.write_attribute(ua.AttributeIds.Description, ua.DataValue(ua.Variant(text)))
        self._server.set_attribute_value_callback(nodeid, self._read)
        # Without this, the library would store what subscribers are told, and answer with that from then on.
        self._server.set_attribute_value_setter(nodeid, lambda _node, _attribute, _value: None)
        self._variables[nodeid] = surface, name

    def _read(self, nodeid: ua.NodeId, _attribute: ua.AttributeIds) -> ua.DataValue:
        """Return the value of a variable now, for a client that reads it or begins to subscribe to it."""
        surface, name = self._variables[nodeid]
        value = self._look(surface)[name]
        if not _is_same(value, self._told.get(nodeid)):
            self._told.pop(nodeid, None)
        return value

    def _look(self, surface: Surface) -> dict[str, ua.DataValue]:
        """Return the variables of a surface as of now. All that one request asks for belong to one sample."""
        if surface.name not in self._looks:
            found = values(surface, self._context.clock(), datetime.now(UTC))
            self._looks[surface.name] = {name: found.get(name, _GONE) for name in self._names[surface.name]}
            asyncio.get_running_loop().call_soon(self._looks.pop, surface.name)
        return self._looks[surface.name]

    def note_subscription(self, event: Callback) -> None:
        """Tell the surfaces of the variables that a client has subscribed to from now on."""
        for item in event.request_params.ItemsToCreate:
            surface, _ = self._variables.get(item.ItemToMonitor.NodeId, (None, ""))
            if surface is not None and surface.name not in self._subscribed:
                self._subscribed[surface.name] = surface
                self._is_changed.set()
                if self._watch:
                    self._watch.wake()

    async def require_same_axes(self) -> None:
        """Look at the axes of all surfaces until cancelled; raises OtherAxesError once one has others."""
        while True:
            if any(surface.axes != self.axes[surface.name] for surface in self._context.registry):
                raise OtherAxesError
            await asyncio.sleep(LOOK_S)

    async def follow(self, interval_s: float) -> None:
        """Tell subscribers what has changed, in turns of this time, until cancelled."""
        while True:
            await self._is_changed.wait()
            self._is_changed.clear()
            surfaces = list(self._subscribed.values())
            pace = Pace(surfaces, interval_s, tells_status_at_once=False)
            self._watch = watch = Watch(surfaces, pace, self._context.clock)
            with watch.listening():
                while not self._is_changed.is_set() and self._subscribed:
                    for surface in watch.take_due():
                        await self._tell(surface)
                    await watch.wait()
                    if not self._server.iserver.subscription_service.subscriptions:
                        self._subscribed.clear()

    async def _tell(self, surface: Surface) -> None:
        """Tell the subscribers of a surface what they do not have yet, all of it before other work goes on."""
        index = self.objects[surface.name].NamespaceIndex
        for name, value in self._look(surface).items():
            nodeid = ua.NodeId(f"{surface.name}/{name}", index)
            if not _is_same(value, self._told.get(nodeid)):
                self._told[nodeid] = value
                told = _Told(value.Value, value.StatusCode, value.SourceTimestamp, value.ServerTimestamp)
                await self._server.write_attribute_value(nodeid, told)
        await asyncio.sleep(0)


def _is_same(value: ua.DataValue, other: ua.DataValue | None) -> bool:
    """Return whether two values differ in their times at most."""
    return other is not None and value.StatusCode == other.StatusCode and value.Value == other.Value
