"""The OPC UA server: its address, its start and its end. It runs on the event loop of the service."""

import asyncio
import gc
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial

from asyncua import Server

from beamtouch_service.access import Access
from beamtouch_service.address import Address
from beamtouch_service.api.context import Context
from beamtouch_service.outputs.opcua.door import Door, Sessions
from beamtouch_service.outputs.opcua.events import EventSender
from beamtouch_service.outputs.opcua.section import OpcUaSection
from beamtouch_service.outputs.opcua.security import Security, read_security
from beamtouch_service.outputs.opcua.space import OtherAxesError, Space
from beamtouch_service.outputs.section import Output

APPLICATION = "urn:beamtouch:service"
"""The application that the certificate of the server names."""
STOP_S = 1.0
"""Time for the clients to take their leave."""
ORPHANS_S = 1.0
"""Time between two looks for subscriptions without a session."""

_log = logging.getLogger(__name__)


def make(section: OpcUaSection, _surfaces: Sequence[str], access: Access) -> Output:
    """Return the server.

    Raises
    ------
    InputError
        Its address, password or certificate can never be used, or it lacks what its address requires.
    FailedError
        A file cannot be read.
    """
    # Clients can provoke any number of its messages, and tracebacks.
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    security = read_security(section)
    address = Address(section.name, section.host, section.port, "opcua.port", security.require_for_others)
    is_protected = security.has_password or security.has_trusted or not access.read
    words = "neither a user nor trusted certificates protect the OPC UA server: everyone on this machine can read"
    return Output(partial(_run, section, security, address), [] if is_protected else [words])


async def _run(section: OpcUaSection, security: Security, address: Address, context: Context) -> None:
    """Serve until cancelled. Start again when the model of a surface has other axes, and so other variables."""
    while True:
        try:
            await _serve(section, security, address, context)
        except* OtherAxesError:
            _log.info("OPC UA server: a surface has a model with other axes: starting again, with its variables")


async def _serve(section: OpcUaSection, security: Security, address: Address, context: Context) -> None:
    """Serve, as soon as the address is there, until cancelled; raises a group with OtherAxesError."""
    while True:
        sessions = Sessions(security.clients)
        server, door = Server(iserver=sessions), Door(sessions)
        await _prepare(server, section)
        await security.apply(server, door)
        await door.guard(server)
        space = Space(server, context)
        await space.build()
        door.created.add(space.note_subscription)
        events = EventSender(server, context.recorder, space.objects, space.axes.values())
        await events.describe()
        (await address.listen(partial(context.missing.__setitem__, section.name))).close()
        # The numeric address: the name may lead elsewhere by now.
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
            # One that fails must not end the sessions of clients.
            tasks.create_task(context.parts.keep(f"{section.name} events", events.run))
            tasks.create_task(_end_orphans(sessions))
            tasks.create_task(space.require_same_axes())
    finally:
        sessions.asyncio_transports.end()
        with suppress(TimeoutError):
            async with asyncio.timeout(STOP_S):
                await server.stop()


async def _prepare(server: Server, section: OpcUaSection) -> None:
    """Make the standard nodes of a server, and name it."""
    with _without_collection():
        await server.init()
    server.set_endpoint(_url(section.host, section.port))
    server.set_server_name("Beamtouch")
    await server.set_application_uri(APPLICATION)


@contextmanager
def _without_collection() -> Iterator[None]:
    """Search for no garbage. The standard nodes are 6000 of many objects, all of which stay.

    Searching those that are there again and again takes longer than making them.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


async def _end_orphans(sessions: Sessions) -> None:
    while True:
        await asyncio.sleep(ORPHANS_S)
        await sessions.end_orphans()


def _url(host: str, port: int) -> str:
    return f"opc.tcp://{f'[{host}]' if ':' in host else host}:{port}/"
