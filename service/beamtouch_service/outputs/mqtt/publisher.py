"""Keeps a connection to the broker, and sends contacts, statuses and events over it. Nothing else waits for it."""

import asyncio
import logging
import ssl
from collections.abc import Callable, Sequence
from enum import Enum, auto
from functools import partial
from time import monotonic
from typing import Protocol

from beamtouch_common.errors import InputError
from beamtouch_common.log_lines import Repeated
from beamtouch_common.secrets import read_password
from beamtouch_common.waits import Backoff
from beamtouch_service.access import Access
from beamtouch_service.api.context import Context
from beamtouch_service.outputs.mqtt.connection import Connection
from beamtouch_service.outputs.mqtt.contacts import ContactSender
from beamtouch_service.outputs.mqtt.descriptions import DescriptionSender
from beamtouch_service.outputs.mqtt.events import EventSender
from beamtouch_service.outputs.mqtt.failures import BrokerError, RefusedError
from beamtouch_service.outputs.mqtt.leftovers import Leftovers
from beamtouch_service.outputs.mqtt.messages import ONLINE, TEXT, Topics
from beamtouch_service.outputs.mqtt.section import MqttSection
from beamtouch_service.outputs.mqtt.statuses import StatusSender
from beamtouch_service.outputs.section import Output
from beamtouch_service.sections import load_pair, require_readable

RETRY_S, MAX_RETRY_S = 0.5, 8.0
"""Pause after a connection was lost, and the longest one."""

_log = logging.getLogger(__name__)


def make(section: MqttSection, _surfaces: Sequence[str], _access: Access) -> Output:
    """Read the password and the TLS files; raises InputError and FailedError if they cannot be used."""
    tls = _tls(section)
    password = read_password(section.password_file) if section.password_file else None
    words = "no TLS to the MQTT broker: others on the network can read the password; see mqtt.tls"
    connect = partial(Connection, section, password, tls)
    return Output(
        lambda context: Publisher(section, context, connect).run(), [words] if password is not None and not tls else []
    )


class _Status(Enum):
    """The connection to the broker, as far as the log has it."""

    STARTING = auto()
    """There was none yet."""
    CONNECTED = auto()
    LOST = auto()
    """The log does not say so: it said the same less than a minute ago."""
    LOST_AS_LOGGED = auto()


class _Sender(Protocol):
    """Sends messages of one kind."""

    async def run(self, connection: Connection) -> None:
        """Send over a connection; raises BrokerError when it is lost."""


class Publisher:
    """The connections to one broker, one after the other, and what is sent over them."""

    def __init__(self, section: MqttSection, context: Context, connect: Callable[[], Connection]) -> None:
        self._section = section
        self._context = context
        self._connect = connect
        self._where = f"{section.host}:{section.broker_port}"
        self._topics = topics = Topics(section.prefix)
        self._connected = context.counts.gauge("mqtt_connected", "1 while the MQTT broker answers.")
        sent = context.counts.counter("mqtt_messages", "Messages sent to the MQTT broker.", "kind")
        self._events = EventSender(context, section, topics, sent.labels("event"))
        surfaces = list(context.registry) if section.home_assistant_discovery else []
        self._descriptions = DescriptionSender(topics, surfaces)
        self._leftovers = Leftovers(topics, context.registry.names, self._descriptions.texts, self._where)
        self._senders: dict[str, _Sender] = {
            "events": self._events,
            "contacts": ContactSender(context, topics, section.max_rate_hz, sent.labels("contact")),
            "statuses": StatusSender(context, topics),
            "descriptions": self._descriptions,
            "leftovers": self._leftovers,
        }
        self._status = _Status.STARTING
        self._reason = ""
        """Why there was no connection last, as it was logged."""
        self._lost_s = monotonic()
        """When the connection was lost, or the service started."""
        self._repeated = Repeated(_log)

    async def run(self) -> None:
        """Connect, and connect again after each failure, until cancelled."""
        backoff = Backoff(RETRY_S, MAX_RETRY_S)
        while True:
            # Before the first connection, too: a new broker gets the events from now on.
            await self._events.count_pending()
            begin_s = monotonic()
            await self._serve_connection()
            if monotonic() - begin_s > backoff.steady_s:
                backoff.reset()
            await asyncio.sleep(backoff.next())

    async def _serve_connection(self) -> None:
        """Connect, and send until the connection is lost."""
        connection = self._connect()
        try:
            await connection.open()
            await self._introduce(connection)
            async with asyncio.TaskGroup() as tasks:
                for name, sender in self._senders.items():
                    # One that fails must not end the others.
                    work = partial(sender.run, connection)
                    tasks.create_task(self._context.parts.keep(f"{self._section.name} {name}", work, BrokerError))
                tasks.create_task(connection.watch())
        except* BrokerError as failures:
            self._note_failure(failures.exceptions[0])
        finally:
            connection.close()
            self._connected.set(0)

    async def _introduce(self, connection: Connection) -> None:
        """Say that the service is there, and describe its surfaces if that was asked for."""
        await connection.require_kept(self._topics.status, ONLINE.encode(), TEXT)
        self._descriptions.update()
        await self._leftovers.begin(connection)
        await self._descriptions.send_all(connection)
        self._note_connected()

    def _note_connected(self) -> None:
        """Say that the broker is there, unless the log says so already."""
        if self._status is _Status.LOST_AS_LOGGED:
            _log.info("MQTT broker %s: connected again after %.1f s", self._where, monotonic() - self._lost_s)
        elif self._status is _Status.STARTING:
            _log.info("MQTT broker %s: connected; topics %s/...", self._where, self._section.prefix)
        self._status = _Status.CONNECTED
        self._connected.set(1)
        self._context.missing[self._section.name] = ""

    def _note_failure(self, failure: Exception) -> None:
        """Log why there is no connection: once per outage, and again if the broker refuses what it did not before.

        Outages that follow each other within a minute for the same reason are counted in the next line.
        """
        if self._status in {_Status.STARTING, _Status.CONNECTED}:
            self._lost_s = monotonic()
        reason = str(failure)
        self._context.missing[self._section.name] = f"broker {self._where}: {reason}"
        is_another_refusal = isinstance(failure, RefusedError) and reason != self._reason
        if self._status is _Status.LOST_AS_LOGGED and not is_another_refusal:
            return
        line = self._repeated.line_if_due(
            f"MQTT broker {self._where}: {reason}; the service goes on and tries again", reason
        )
        if line:
            _log.warning("%s", line)
            self._status, self._reason = _Status.LOST_AS_LOGGED, reason
        elif self._status is not _Status.LOST_AS_LOGGED:
            self._status = _Status.LOST


def _tls(section: MqttSection) -> ssl.SSLContext | None:
    """Return the TLS context of connections; raises FailedError if a file cannot be read, InputError if it is wrong."""
    if not section.tls:
        return None
    certificate, key = section.certificate_file, section.key_file
    if section.ca_file:
        require_readable(section.ca_file)
    try:
        context = ssl.create_default_context(cafile=section.ca_file)
    except ssl.SSLError:
        message = f"{section.ca_file}: not PEM; set mqtt.ca_file to the PEM certificates of the broker's issuer"
        raise InputError(message) from None
    if certificate and key:
        load_pair(context, certificate, key, "correct mqtt.certificate_file and mqtt.key_file")
    return context
