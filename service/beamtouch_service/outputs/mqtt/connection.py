"""One connection to the broker: aiomqtt on a socket of our own, which can be cut at any time.

What aiomqtt 2.5 on paho-mqtt 2 leaves open, and this module adds:

- paho connects in a thread that nothing can interrupt. Here the event loop connects, and a cut ends the TLS handshake.
- aiomqtt writes a message one turn of the loop after it was given, so it may grow old in between. Here it is written
  at once, or waits as the only one.
- aiomqtt drops the reason code of an acknowledgement, which may be a refusal.

pyproject.toml states the versions whose inner methods (`_on_publish`, `_on_socket_register_write`, `_connected`, and
paho's `_create_socket_connection`) this was tested with.
"""

import asyncio
import logging
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import aiomqtt
import paho.mqtt.client as paho
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from beamtouch_service.outputs.mqtt import tls
from beamtouch_service.outputs.mqtt.section import MqttSection
from beamtouch_service.outputs.mqtt.topics import OFFLINE, Topics

ANSWER_S = 5.0
"""A broker that takes longer to connect, or to answer, counts as lost."""
KEEPALIVE_S = 5
"""A service that is silent for one and a half times this long is offline to the broker. It sends more often."""
WINDOW = 10
"""Messages that may wait for their acknowledgement."""
_AT_LEAST_ONCE = 1
_NO_MATCHING_SUBSCRIBERS = 0x10

_library_log = logging.getLogger("beamtouch.service.mqtt.library")
# Errors of the library reach us as exceptions.
_library_log.setLevel(logging.CRITICAL)


class RefusedError(aiomqtt.MqttError):
    """The broker acknowledged a message and refused it; the text is the broker's reason."""


class Connection(aiomqtt.Client):
    """A connection to the broker."""

    def __init__(self, settings: MqttSection, password: str | None, line: socket.socket) -> None:
        """Speak over `line`, a connected socket. Raises InputError if the TLS files cannot be used."""
        status = Topics(settings.prefix).status
        super().__init__(
            settings.host,
            settings.broker_port,
            username=settings.username,
            password=password,
            identifier=settings.client_id or settings.prefix,
            protocol=aiomqtt.ProtocolVersion.V5,
            will=aiomqtt.Will(status, OFFLINE, _AT_LEAST_ONCE, retain=True),
            clean_start=True,
            timeout=ANSWER_S,
            keepalive=KEEPALIVE_S,
            max_queued_outgoing_messages=WINDOW,
            max_inflight_messages=WINDOW,
            tls_context=tls.context(settings) if settings.tls else None,
            logger=_library_log,
        )
        self._client._create_socket_connection = lambda: line  # type: ignore[method-assign]  # paho would block
        self._status = status
        self.telling = asyncio.Lock()
        """For senders of a `tell`: `refusal` and `has_listeners` are of its messages alone."""
        self.refusal: str | None = None
        """The reason why the broker refused a message of the last `tell`. Some brokers then end the connection."""
        self.has_listeners = True
        """Whether the broker had a subscriber for all messages of the last `tell`."""

    async def confirm(self) -> None:
        """Return once the broker has answered; raises MqttError if it does not.

        To leave a topic that nobody joined is the one request that every broker answers and that changes nothing.
        """
        await self.unsubscribe(self._status)

    async def tell(self, *messages: tuple[str, bytes], content_type: Properties, retain: bool = False) -> None:
        """Send messages, each a topic and its text, and return when the broker has acknowledged all.

        Raises
        ------
        RefusedError
            The broker refused one. It may have taken the others.
        aiomqtt.MqttError
            The connection is lost, or the broker does not answer.
        """
        self.refusal, self.has_listeners = None, True
        calls = (self.publish(topic, text, _AT_LEAST_ONCE, retain, content_type) for topic, text in messages)
        await asyncio.gather(*calls)
        if self.refusal is not None:
            raise RefusedError(self.refusal)

    async def watch(self) -> None:
        """Wait until the connection is lost; raises MqttError then."""
        async for _message in self.messages:
            pass

    def _on_publish(
        self, client: paho.Client, userdata: object, mid: int, reason_code: ReasonCode, properties: Properties
    ) -> None:
        if reason_code.is_failure:
            self.refusal = str(reason_code)
        elif reason_code.value == _NO_MATCHING_SUBSCRIBERS:
            self.has_listeners = False
        super()._on_publish(client, userdata, mid, reason_code, properties)

    def _on_socket_register_write(self, client: paho.Client, userdata: object, sock: socket.socket) -> None:
        if not self._connected.done():
            # Perhaps in the thread that connects.
            super()._on_socket_register_write(client, userdata, sock)
            return
        client.loop_write()
        if client.want_write() and client.socket() is not None:
            # The rest when the socket takes it.
            self._loop.add_writer(sock.fileno(), client.loop_write)


@asynccontextmanager
async def connected(settings: MqttSection, password: str | None) -> AsyncIterator[Connection]:
    """Give a connection for a block, and cut it at the end: the broker then publishes the will.

    Raises
    ------
    aiomqtt.MqttError, OSError, InputError
        There is no connection.
    """
    line = await _line(settings.host, settings.broker_port)
    handle = line.dup()
    try:
        async with Connection(settings, password, line) as connection:
            try:
                yield connection
            finally:
                # Before the client ends: it would first write what has waited for the socket.
                _cut(handle)
    finally:
        _cut(handle)
        handle.close()


async def _line(host: str, port: int) -> socket.socket:
    """Return a socket that is connected to the broker; raises OSError (TimeoutError too)."""
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(ANSWER_S):
        failure = OSError(f"{host} has no address")
        for family, kind, protocol, _, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
            line = socket.socket(family, kind, protocol)
            try:
                line.setblocking(False)
                # Otherwise each small message would wait for the acknowledgement of the one before it.
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                await loop.sock_connect(line, address)
            except OSError as error:
                failure = error
            except BaseException:
                line.close()
                raise
            else:
                return line
            line.close()
        raise failure


def _cut(handle: socket.socket) -> None:
    with suppress(OSError):
        handle.shutdown(socket.SHUT_RDWR)
