"""One connection to the broker: paho-mqtt in the event loop, by its public functions for loops of one's own.

Connecting blocks, so it runs in a thread. From then on, each message is written at once, in the turn of the loop that
made it; what the socket does not take at once waits in paho, and `send` gives up on a connection where that takes too
long.
"""

import asyncio
import socket
import ssl
import struct
from functools import partial

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from beamtouch_common.threads import in_thread
from beamtouch_service.outputs.mqtt.answers import BrokerAnswer, BrokerAnswers
from beamtouch_service.outputs.mqtt.failures import LOST, BrokerError, RefusedError, reason_of, words_for
from beamtouch_service.outputs.mqtt.messages import OFFLINE, TEXT, Kept, Topics, kept_properties, read_kept
from beamtouch_service.outputs.mqtt.section import MqttSection

ANSWER_S = 5.0
"""A broker that takes longer to connect, or to answer, counts as lost."""
KEEPALIVE_S = 5
"""A service that is silent for one and a half times this long is offline to the broker. It sends more often."""
WINDOW = 10
"""Messages that may wait for their acknowledgement."""
REFUSED_RETRY_S = 30.0
"""Pause after the broker refused a message: someone has to change its rights first."""
_LOOK_S = 1.0
"""Time between two looks of paho at its keepalive."""
_UNSENT_BYTES = 4096
"""Unsent bytes that the system may hold. Contacts grow old there, and nobody can take them out."""
_AT_LEAST_ONCE = 1
_NO_MATCHING_SUBSCRIBERS = 0x10
_CONNECT = 0
"""Stands for the connection among the numbers of requests, which begin at 1."""
_DROP_UNSENT = struct.pack("ii", 1, 0)
"""SO_LINGER: a close drops what the system still holds."""


class Connection:
    """A connection to the broker."""

    def __init__(self, section: MqttSection, password: str | None, tls: ssl.SSLContext | None) -> None:
        self._loop = asyncio.get_running_loop()
        self.owner = section.client_id or section.prefix
        """The client identifier, which no other client of the broker has."""
        self.received = asyncio.Queue[Kept]()
        """Messages of the topics that were subscribed to."""
        self._nothing = f"{Topics(section.prefix).status}/nothing"
        """A topic to which this service never subscribes: `confirm` unsubscribes from it."""
        self._socket: socket.socket | None = None
        """The socket that the event loop watches."""
        self._answers = BrokerAnswers()
        self._lost = asyncio.Event()
        self._loss = ""
        """Why the connection is lost."""
        self._client = self._make_client(section, password, tls)
        self._connect = partial(self._client.connect, section.host, section.broker_port, KEEPALIVE_S, clean_start=True)

    def _make_client(self, section: MqttSection, password: str | None, tls: ssl.SSLContext | None) -> paho.Client:
        client = paho.Client(CallbackAPIVersion.VERSION2, client_id=self.owner, protocol=paho.MQTTv5)
        client.connect_timeout = ANSWER_S
        client.max_inflight_messages_set(WINDOW)
        status, will = Topics(section.prefix).status, kept_properties(TEXT, self.owner, will=True)
        client.will_set(status, OFFLINE, _AT_LEAST_ONCE, retain=True, properties=will)
        if section.username:
            client.username_pw_set(section.username, password)
        if tls:
            client.tls_set_context(tls)
        give = self._answers.give
        client.on_connect = lambda _client, _data, _flags, reason, _properties: give(_CONNECT, reason)
        client.on_publish = lambda _client, _data, number, reason, _properties: give(number, reason)
        client.on_subscribe = lambda _client, _data, number, reasons, _properties: give(number, reasons[0])
        client.on_unsubscribe = lambda _client, _data, number, reasons, _properties: give(number, reasons[0])
        client.on_message = lambda _client, _data, message: self.received.put_nowait(read_kept(message))
        # Perhaps in the thread that connects.
        client.on_disconnect = lambda _client, _data, _flags, reason, _properties: self._lose_soon(str(reason))
        client.on_socket_close = lambda _client, _data, sock: self._forget(sock)
        return client

    async def open(self) -> None:
        """Connect; raises BrokerError."""
        try:
            await in_thread(self._connect)
        except OSError as error:
            raise BrokerError(reason_of(error)) from None
        sock = self._client.socket()
        if not isinstance(sock, socket.socket):
            raise BrokerError(LOST)
        # Otherwise each small message would wait for the acknowledgement of the one before it.
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _UNSENT_BYTES)
        self._socket = sock
        self._loop.add_reader(sock, self._read)
        self._write_rest()
        reason = await self._answers.wait(self._answers.expect(_CONNECT), ANSWER_S)
        if reason.is_failure:
            raise RefusedError(words_for(str(reason)))

    def close(self) -> None:
        """End the connection, without what waits to be sent. The broker then publishes the will."""
        sock = self._socket
        if sock is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _DROP_UNSENT)
            self._forget(sock)
            sock.close()

    async def watch(self) -> None:
        """Wait until the connection is lost; raises BrokerError then."""
        while not self._lost.is_set():
            self._client.loop_misc()
            try:
                async with asyncio.timeout(_LOOK_S):
                    await self._lost.wait()
            except TimeoutError:
                continue
        raise BrokerError(self._loss)

    async def confirm(self) -> None:
        """Return once the broker has answered; raises BrokerError if it does not.

        MQTT has a ping, but paho sends it by itself, after `KEEPALIVE_S` of silence, and tells nobody of the answer.
        To unsubscribe from a topic that was never subscribed to is the one other request that every broker answers,
        whatever the rights of the user, and that changes nothing.
        """
        result, number = self._client.unsubscribe(self._nothing)
        await self._answers.wait(self._sent(result, number), ANSWER_S)

    async def subscribe(self, topic: str) -> None:
        """Subscribe to a topic; raises RefusedError, and BrokerError.

        What the broker keeps there is in `received` soon, and what is sent to it from now on.
        """
        result, number = self._client.subscribe(topic, options=SubscribeOptions(qos=_AT_LEAST_ONCE))
        reason = await self._answers.wait(self._sent(result, number), ANSWER_S)
        if reason.is_failure:
            raise RefusedError(str(reason))

    async def send(self, topic: str, text: bytes, properties: Properties, timeout_s: float) -> None:
        """Write a message now; raises BrokerError if the socket has not taken it after `timeout_s` [s].

        Then the connection must be closed: it would write the message later.
        """
        message = self._client.publish(topic, text, properties=properties)
        answer = self._sent(message.rc, message.mid)
        if message.is_published():
            self._answers.give(message.mid, None)
        else:
            await self._answers.wait(answer, timeout_s)

    async def keep(self, topic: str, text: bytes, content_type: str) -> None:
        """Have the broker keep a message; an empty text has it forget the one of this topic. Raises as `tell`."""
        await self.tell((topic, text), properties=kept_properties(content_type, self.owner), retain=True)

    async def require_kept(self, topic: str, text: bytes, content_type: str) -> None:
        """Have the broker keep a message that must be there; raises BrokerError, with what to do if it is refused."""
        try:
            await self.keep(topic, text, content_type)
        except RefusedError as error:
            raise RefusedError(f"it refuses messages to {topic} ({error}); allow this user to write there") from None

    async def tell(self, *messages: tuple[str, bytes], properties: Properties, retain: bool = False) -> bool:
        """Send messages, each a topic and its text, and wait until the broker has acknowledged all.

        Returns
        -------
        Whether the broker had a subscriber for each.

        Raises
        ------
        RefusedError
            The broker refused one. It may have taken the others. Some brokers then end the connection.
        BrokerError
            The connection is lost, or the broker does not answer.
        """
        sent = [self._client.publish(topic, text, _AT_LEAST_ONCE, retain, properties) for topic, text in messages]
        expected = [self._sent(message.rc, message.mid) for message in sent]
        answers = await asyncio.gather(*(self._answers.wait(one, ANSWER_S) for one in expected), return_exceptions=True)
        reasons = [answer for answer in answers if isinstance(answer, ReasonCode)]
        refusals = [str(reason) for reason in reasons if reason.is_failure]
        if refusals:
            raise RefusedError(refusals[0])
        for answer in answers:
            if isinstance(answer, BaseException):
                raise answer
        return all(reason.value != _NO_MATCHING_SUBSCRIBERS for reason in reasons)

    def _sent(self, result: MQTTErrorCode, number: int | None) -> BrokerAnswer:
        """Return the answer to come of a request that was just made; raises BrokerError if there is no connection."""
        if result != MQTTErrorCode.MQTT_ERR_SUCCESS or number is None or self._lost.is_set():
            raise BrokerError(self._loss or LOST)
        self._write_rest()
        return self._answers.expect(number)

    def _lose_soon(self, reason: str) -> None:
        self._loop.call_soon_threadsafe(self._lose, words_for(reason))

    def _lose(self, reason: str) -> None:
        self._loss = self._loss or reason
        self._lost.set()
        self._answers.lose(self._loss)

    def _read(self) -> None:
        sock = self._socket
        self._client.loop_read()
        # The event loop sees only the socket, not what TLS has decrypted already.
        while self._socket is sock and isinstance(sock, ssl.SSLSocket) and sock.pending():
            self._client.loop_read()
        self._write_rest()

    def _write_rest(self) -> None:
        """Write what waits, when the socket takes it."""
        if self._socket is not None and self._client.want_write():
            self._loop.add_writer(self._socket, self._write)

    def _write(self) -> None:
        self._client.loop_write()
        if self._socket is not None and not self._client.want_write():
            self._loop.remove_writer(self._socket)

    def _forget(self, sock: object) -> None:
        """Watch a socket no longer, before it closes."""
        if self._socket is not None and sock is self._socket:
            self._loop.remove_reader(self._socket)
            self._loop.remove_writer(self._socket)
            self._socket = None
