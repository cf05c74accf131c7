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
_NO_ANSWER, _LOST = "it does not answer", "the connection is lost"
_ACCOUNT = "check mqtt.username and mqtt.password_file"
_OTHER = "use a broker that does"
_WORDS = {
    "Unspecified error": _LOST,
    "Keep alive timeout": _NO_ANSWER,
    "Bad user name or password": f"it refuses the user name or the password; {_ACCOUNT}",
    "Not authorized": f"it refuses this client: not authorized; {_ACCOUNT}, and the rights of this user",
    "Unsupported protocol version": f"it does not speak MQTT 5; {_OTHER}",
    "QoS not supported": f"it does not take messages of QoS 1; {_OTHER}",
    "Retain not supported": f"it does not retain messages; {_OTHER}",
    "Packet too large": "it takes no messages of this size; raise its limit to 64 KiB or more",
    "Client identifier not valid": "it refuses the client identifier; correct mqtt.client_id",
    "Use another server": "it says that another broker is to be used; correct mqtt.host",
    "Server moved": "it says that the broker has moved; correct mqtt.host",
    "Protocol error": "its answers are not MQTT 5; are mqtt.host and mqtt.port those of a broker that speaks it?",
    "Session taken over": "another client has the same mqtt.client_id; each service needs a prefix of its own",
}
"""The protocol's words for a failure, and those of the log."""


Answer = asyncio.Future[ReasonCode | None]
"""The broker's answer to a request; None if the connection is lost before."""


class BrokerError(Exception):
    """There is no connection; the text says why."""


class RefusedError(BrokerError):
    """The broker refused the client, or a message; the text is its reason."""


class Connection:
    """A connection to the broker."""

    def __init__(self, section: MqttSection, password: str | None, tls: ssl.SSLContext | None) -> None:
        self._loop = asyncio.get_running_loop()
        self.owner = section.client_id or section.prefix
        """The client identifier, which no other client of the broker has."""
        self.received = asyncio.Queue[Kept]()
        """Messages of the topics that were subscribed to."""
        status = Topics(section.prefix).status
        self._nothing = f"{status}/nothing"
        """A topic that nobody joins."""
        self._client = client = paho.Client(
            CallbackAPIVersion.VERSION2,
            client_id=self.owner,
            protocol=paho.MQTTv5,
            reconnect_on_failure=False,
        )
        client.connect_timeout = ANSWER_S
        client.max_inflight_messages_set(WINDOW)
        will = kept_properties(TEXT, self.owner, will=True)
        client.will_set(status, OFFLINE, _AT_LEAST_ONCE, retain=True, properties=will)
        if section.username:
            client.username_pw_set(section.username, password)
        if tls:
            client.tls_set_context(tls)
        client.on_connect = lambda _client, _data, _flags, reason, _properties: self._give(_CONNECT, reason)
        client.on_publish = lambda _client, _data, number, reason, _properties: self._give(number, reason)
        client.on_subscribe = lambda _client, _data, number, reasons, _properties: self._give(number, reasons[0])
        client.on_unsubscribe = lambda _client, _data, number, reasons, _properties: self._give(number, reasons[0])
        client.on_message = lambda _client, _data, message: self.received.put_nowait(read_kept(message))
        # Perhaps in the thread that connects.
        client.on_disconnect = lambda _client, _data, _flags, reason, _properties: self._lose_soon(str(reason))
        client.on_socket_close = lambda _client, _data, line: self._forget(line)
        self._connect = partial(client.connect, section.host, section.broker_port, KEEPALIVE_S, clean_start=True)
        self._line: socket.socket | None = None
        """The socket that the event loop watches."""
        self._answers: dict[int, Answer] = {}
        """Number of a request -> its answer."""
        self._lost = asyncio.Event()
        self._reason = ""

    async def open(self) -> None:
        """Connect; raises BrokerError."""
        try:
            await in_thread(self._connect)
        except OSError as error:
            raise BrokerError(_reason(error)) from None
        line = self._client.socket()
        if not isinstance(line, socket.socket):
            raise BrokerError(_LOST)
        # Otherwise each small message would wait for the acknowledgement of the one before it.
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _UNSENT_BYTES)
        self._line = line
        self._loop.add_reader(line, self._read)
        self._write_rest()
        reason = await self._answer(self._expect(_CONNECT), ANSWER_S)
        if reason.is_failure:
            raise RefusedError(_words(str(reason)))

    def close(self) -> None:
        """End the connection, without what waits to be sent. The broker then publishes the will."""
        line = self._line
        if line is not None:
            line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _DROP_UNSENT)
            self._forget(line)
            line.close()

    async def watch(self) -> None:
        """Wait until the connection is lost; raises BrokerError then."""
        while not self._lost.is_set():
            self._client.loop_misc()
            try:
                async with asyncio.timeout(_LOOK_S):
                    await self._lost.wait()
            except TimeoutError:
                continue
        raise BrokerError(self._reason)

    async def confirm(self) -> None:
        """Return once the broker has answered; raises BrokerError if it does not.

        To leave a topic that nobody joined is the one request that every broker answers and that changes nothing.
        """
        result, number = self._client.unsubscribe(self._nothing)
        await self._answer(self._sent(result, number), ANSWER_S)

    async def subscribe(self, topic: str) -> None:
        """Subscribe to a topic; raises RefusedError, and BrokerError.

        What the broker keeps there is in `received` soon, and what is sent to it from now on.
        """
        result, number = self._client.subscribe(topic, options=SubscribeOptions(qos=_AT_LEAST_ONCE))
        reason = await self._answer(self._sent(result, number), ANSWER_S)
        if reason.is_failure:
            raise RefusedError(str(reason))

    async def send(self, topic: str, text: bytes, properties: Properties, timeout_s: float) -> None:
        """Write a message now; raises BrokerError if the socket has not taken it after `timeout_s` [s].

        Then the connection must be closed: it would write the message later.
        """
        message = self._client.publish(topic, text, properties=properties)
        answer = self._sent(message.rc, message.mid)
        if message.is_published():
            self._give(message.mid, None)
        else:
            await self._answer(answer, timeout_s)

    async def keep(self, topic: str, text: bytes, content_type: str) -> None:
        """Have the broker keep a message; an empty text has it forget the one of this topic. Raises as `tell`."""
        await self.tell((topic, text), properties=kept_properties(content_type, self.owner), retain=True)

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
        answers = await asyncio.gather(*(self._answer(one, ANSWER_S) for one in expected), return_exceptions=True)
        reasons = [answer for answer in answers if isinstance(answer, ReasonCode)]
        refusals = [str(reason) for reason in reasons if reason.is_failure]
        if refusals:
            raise RefusedError(refusals[0])
        for answer in answers:
            if isinstance(answer, BaseException):
                raise answer
        return all(reason.value != _NO_MATCHING_SUBSCRIBERS for reason in reasons)

    def _sent(self, result: MQTTErrorCode, number: int | None) -> Answer:
        """Return the answer to come of a request that was just made; raises BrokerError if there is no connection."""
        if result != MQTTErrorCode.MQTT_ERR_SUCCESS or number is None or self._lost.is_set():
            raise BrokerError(self._reason or _LOST)
        self._write_rest()
        return self._expect(number)

    def _expect(self, number: int) -> Answer:
        """Return the answer to come of a request; call this before the event loop may read it."""
        answer: Answer = self._loop.create_future()
        answer.add_done_callback(lambda _answer: self._answers.pop(number))
        self._answers[number] = answer
        return answer

    async def _answer(self, answer: Answer, timeout_s: float) -> ReasonCode:
        try:
            async with asyncio.timeout(timeout_s):
                reason = await answer
        except TimeoutError:
            raise BrokerError(_NO_ANSWER) from None
        if reason is None:
            raise BrokerError(self._reason)
        return reason

    def _give(self, number: int, reason: ReasonCode | None) -> None:
        answer = self._answers.get(number)
        if answer is not None and not answer.done():
            answer.set_result(reason)

    def _lose_soon(self, reason: str) -> None:
        self._loop.call_soon_threadsafe(self._lose, _words(reason))

    def _lose(self, reason: str) -> None:
        self._reason = self._reason or reason
        self._lost.set()
        for number in list(self._answers):
            self._give(number, None)

    def _read(self) -> None:
        line = self._line
        self._client.loop_read()
        # The event loop sees only the socket, not what TLS has decrypted already.
        while self._line is line and isinstance(line, ssl.SSLSocket) and line.pending():
            self._client.loop_read()
        self._write_rest()

    def _write_rest(self) -> None:
        """Write what waits, when the socket takes it."""
        if self._line is not None and self._client.want_write():
            self._loop.add_writer(self._line, self._write)

    def _write(self) -> None:
        self._client.loop_write()
        if self._line is not None and not self._client.want_write():
            self._loop.remove_writer(self._line)

    def _forget(self, line: object) -> None:
        """Watch a socket no longer, before it closes."""
        if self._line is not None and line is self._line:
            self._loop.remove_reader(self._line)
            self._loop.remove_writer(self._line)
            self._line = None


def _words(reason: str) -> str:
    return _WORDS.get(reason, reason)


def _reason(error: OSError) -> str:
    """Return why there is no connection."""
    if isinstance(error, TimeoutError):
        return _NO_ANSWER
    if isinstance(error, ssl.SSLCertVerificationError):
        # 9, 10: not yet valid, expired.
        advice = (
            "renew it, or check the clock of this machine" if error.verify_code in {9, 10} else "check mqtt.ca_file"
        )
        return f"certificate verify failed: {error.verify_message.rstrip('.')}; {advice}"
    return str(error) if isinstance(error, ssl.SSLError) else error.strerror or str(error)
