"""The OPC UA server: its address and its security, and what its variables answer.

Nothing is stored: whoever reads a variable, or begins to subscribe to it, gets the contact of that moment. Clients that
have subscribed are told of changes at the interval of the section, whether samples come or not.

The server has a thread and an event loop of its own: it takes seconds to make its standard nodes, and its answers are
slow beside those over HTTP, which must not wait for them. The thread only reads what is replaced as a whole: the newest
sample of a surface with its decision, and its model.
"""

import asyncio
import logging
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial

from asyncua import Node, Server, ua
from asyncua.common.callback import Callback, CallbackType

from beamtouch_common.threads import in_thread
from beamtouch_service.access import Access
from beamtouch_service.address import Address
from beamtouch_service.api.context import Context
from beamtouch_service.outputs.opcua.events import EventSender
from beamtouch_service.outputs.opcua.section import OpcUaSection
from beamtouch_service.outputs.opcua.security import ReadOnlyServer, Security, read_security
from beamtouch_service.outputs.opcua.subscriptions import ExactSubscriptions
from beamtouch_service.outputs.opcua.values import Variable, values, variables_of
from beamtouch_service.outputs.section import Output
from beamtouch_service.surfaces.surface import Surface

NAMESPACE = "urn:beamtouch"
"""The namespace of all nodes; a node is `NAME` or `NAME/variable`: no name of a surface has a slash."""
APPLICATION = "urn:beamtouch:service"
"""The application that the certificate of the server names."""
STOP_S = 1.0
"""Time for the clients to take their leave."""

_log = logging.getLogger(__name__)


def make(section: OpcUaSection, _surfaces: Sequence[str], access: Access) -> Output:
    """Return the server; raises InputError and FailedError if its address, password or certificate cannot be used."""
    # Clients can provoke any number of its messages, and tracebacks.
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    security = asyncio.run(read_security(section))
    address = Address(section.name, section.host, section.port, option="opcua.port")
    is_protected = security.has_password or security.has_trusted or (access.read is None and address.is_loopback)
    words = "neither a user nor trusted certificates protect the OPC UA server: everyone who reaches it can read"
    warnings = [] if is_protected else [words]
    if security.has_password and not security.own and not address.is_loopback:
        remedy = "state opcua.certificate_file and opcua.key_file"
        warnings += [
            f"the OPC UA server has no certificate, so its password crosses the network in the clear: {remedy}"
        ]
    return Output(partial(_run, section, security, address), warnings)


async def _run(section: OpcUaSection, security: Security, address: Address, context: Context) -> None:
    """Serve in a thread, until cancelled."""
    main, running = asyncio.get_running_loop(), list[tuple[asyncio.AbstractEventLoop, asyncio.Task[None] | None]]()

    async def serve() -> None:
        running.append((asyncio.get_running_loop(), asyncio.current_task()))
        with suppress(asyncio.CancelledError):
            await _serve(section, security, address, context, main)

    done = in_thread(lambda: asyncio.run(serve()))
    try:
        await asyncio.shield(done)
    finally:
        for loop, task in running:
            if task and not done.done():
                loop.call_soon_threadsafe(task.cancel)
        await asyncio.wait([done], timeout=2 * STOP_S)


async def _serve(
    section: OpcUaSection,
    security: Security,
    address: Address,
    context: Context,
    main: asyncio.AbstractEventLoop,
) -> None:
    """Serve, as soon as the address is there, until cancelled; `main` is the loop of the record."""
    while True:
        server = await _prepare(section, security, address.shown)
        space = Space(server, context)
        await space.build()
        (await address.listen(partial(context.missing.__setitem__, section.name))).close()
        server.set_endpoint(_url(address.shown, section.port))
        try:
            await server.start()
        except OSError:  # somebody else was quicker
            continue
        break
    encrypted = "encrypted" if security.own else "not encrypted"
    _log.info("OPC UA server: listening on %s, %s", _url(address.shown, section.port), encrypted)
    try:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(space.follow(section.interval_ms / 1e3))
            tasks.create_task(EventSender(server, context.recorder, main, space.objects).run())
    finally:
        with suppress(TimeoutError):
            async with asyncio.timeout(STOP_S):
                await server.stop()


def _url(host: str, port: int) -> str:
    return f"opc.tcp://{f'[{host}]' if ':' in host else host}:{port}/"


async def _prepare(section: OpcUaSection, security: Security, host: str) -> Server:
    """Return a server with its security, which does not listen yet."""
    server = Server(ReadOnlyServer(security.clients))
    subscriptions = ExactSubscriptions(server.iserver, section.interval_ms)
    server.iserver.subscription_service = server.iserver.isession.subscription_service = subscriptions
    await server.init()
    server.set_endpoint(_url(host, section.port))
    server.set_server_name("Beamtouch")
    await server.set_application_uri(APPLICATION)
    security.apply(server)
    return server


class Space:
    """The nodes of all surfaces."""

    def __init__(self, server: Server, context: Context) -> None:
        self._server = server
        self._context = context
        self.objects: dict[str, ua.NodeId] = {}
        """Surface -> its object."""
        self._surfaces: dict[ua.NodeId, Surface] = {}
        """Variable -> its surface."""
        self._nodes: dict[str, dict[str, ua.NodeId]] = {}
        """Surface -> name -> variable."""
        self._subscribed: dict[str, Surface] = {}
        self._looks: dict[str, dict[str, ua.DataValue]] = {}
        """Surface -> name -> value, of this turn of the event loop."""

    async def build(self) -> None:
        """Make an object for each surface, with its variables."""
        index = await self._server.register_namespace(NAMESPACE)
        top = self._server.get_objects_node()
        for surface in self._context.registry:
            node = await top.add_object(ua.NodeId(surface.name, index), ua.QualifiedName(surface.name, index))
            self.objects[surface.name], self._nodes[surface.name] = node.nodeid, {}
            for name, variable in variables_of(surface).items():
                await self._add(surface, name, variable, node)
        self._server.subscribe_server_callback(CallbackType.ItemSubscriptionCreated, self._note_subscription)

    async def _add(self, surface: Surface, name: str, variable: Variable, node: Node) -> None:
        """Add a variable to the object of its surface."""
        index = node.nodeid.NamespaceIndex
        nodeid, none = ua.NodeId(f"{surface.name}/{name}", index), ua.Variant(None, ua.VariantType.Null)
        kind = ua.NodeId(getattr(ua.ObjectIds, variable.kind.name))
        added = await node.add_variable(nodeid, ua.QualifiedName(name, index), none, datatype=kind)
        text = ua.LocalizedText(variable.meaning)
        await added.write_attribute(ua.AttributeIds.Description, ua.DataValue(ua.Variant(text)))
        self._server.set_attribute_value_callback(nodeid, lambda _node, _attribute: self._look(surface)[name])
        # Without this, the library would store what subscribers are told, and answer with that from then on.
        self._server.set_attribute_value_setter(nodeid, lambda _node, _attribute, _value: None)
        self._nodes[surface.name][name], self._surfaces[nodeid] = nodeid, surface

    async def follow(self, interval_s: float) -> None:
        """Tell clients of the variables of surfaces that they have subscribed to, until cancelled."""
        while True:
            await asyncio.sleep(interval_s)
            for surface in list(self._subscribed.values()):
                for name, value in self._look(surface).items():
                    await self._server.write_attribute_value(self._nodes[surface.name][name], value)
                # Reads have a turn between two surfaces.
                await asyncio.sleep(0)

    def _look(self, surface: Surface) -> dict[str, ua.DataValue]:
        """Return the variables of a surface as of now. All that one request asks for belong to one sample."""
        if surface.name not in self._looks:
            self._looks[surface.name] = values(surface, self._context.clock(), datetime.now(UTC))
            asyncio.get_running_loop().call_soon(self._looks.pop, surface.name)
        return self._looks[surface.name]

    def _note_subscription(self, event: Callback, _service: object) -> None:
        for item in event.request_params.ItemsToCreate:
            surface = self._surfaces.get(item.ItemToMonitor.NodeId)
            if surface is not None:
                self._subscribed[surface.name] = surface
