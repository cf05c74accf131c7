"""Keeps a connection to the broker, and sends contacts and events over it. Nothing else waits for the broker."""

import asyncio
import logging
import os
import ssl
from collections.abc import Iterator
from time import monotonic

import aiomqtt
from aiomqtt.exceptions import MqttConnectError
from paho.mqtt.reasoncodes import ReasonCode

from beamtouch_common.errors import InputError
from beamtouch_common.secrets import read_password
from beamtouch_service.api.context import Context
from beamtouch_service.outputs.mqtt import discovery, tls
from beamtouch_service.outputs.mqtt.connection import Connection, RefusedError, connected
from beamtouch_service.outputs.mqtt.contacts import ContactSender
from beamtouch_service.outputs.mqtt.counts import MqttCounts
from beamtouch_service.outputs.mqtt.events import EventSender
from beamtouch_service.outputs.mqtt.messages import JSON, TEXT, properties
from beamtouch_service.outputs.mqtt.section import MqttSection
from beamtouch_service.outputs.mqtt.statuses import StatusSender
from beamtouch_service.outputs.mqtt.topics import ONLINE, Topics

RETRY_S, MAX_RETRY_S = 0.5, 8.0
"""Pause after a connection was lost, and the longest one; it doubles with each failure."""
STEADY_S = 10.0
"""A connection that lasts this long ends the doubling."""
_NO_ANSWER, _LOST = "it does not answer", "the connection is lost"
_ACCOUNT = "check mqtt.username and mqtt.password_file"
_WORDS = {
    "": _NO_ANSWER,
    "Operation timed out": _NO_ANSWER,
    "Unspecified error": _LOST,
    "Bad user name or password": f"it refuses the user name or the password; {_ACCOUNT}",
    "Not authorized": f"it refuses this client: not authorized; {_ACCOUNT}, and the rights of this user",
    "Session taken over": "another client has the same mqtt.client_id; each service needs a prefix of its own",
}
"""What the library, or the protocol, says of a failure, and what the log says instead."""

_log = logging.getLogger("beamtouch.service.mqtt")


class Publisher:
    """Sends what the surfaces tell to one broker."""

    def __init__(self, settings: MqttSection) -> None:
        """Check the TLS files and read the password.

        Raises InputError if they cannot be used, FailedError if there is no file of the password yet.
        """
        if settings.tls:
            tls.context(settings)
        self._settings = settings
        self._password = read_password(settings.password_file) if settings.password_file else None
        self._where = f"{settings.host}:{settings.broker_port}"
        self._topics = Topics(settings.prefix)
        self._problem: str | None = None
        """Why there is no connection, as it was logged."""
        self._lost_s = monotonic()

    async def run(self, context: Context) -> None:
        """Serve one application until it ends."""
        settings, counts = self._settings, MqttCounts(context.counts.registry)
        contacts = ContactSender(context, self._topics, settings.max_rate_hz, counts)
        statuses = StatusSender(context, self._topics)
        events = EventSender(context.recorder, f"mqtt://{self._where}/{settings.prefix}", self._topics, counts)
        beginning = asyncio.create_task(events.begin(from_start=settings.send_recorded_events))
        try:
            await self._serve(context, counts, events, (contacts, statuses))
        finally:
            beginning.cancel()

    async def _serve(
        self,
        context: Context,
        counts: MqttCounts,
        events: EventSender,
        others: tuple[ContactSender, StatusSender],
    ) -> None:
        """Connect, and connect again after each failure, until cancelled."""
        settings, pause_s = self._settings, RETRY_S
        while True:
            begin_s = monotonic()
            try:
                async with connected(settings, self._password) as connection, asyncio.TaskGroup() as tasks:
                    await self._introduce(connection, context)
                    counts.connected.set(1)
                    context.missing["mqtt"] = ""
                    for sender in (events, *others):
                        tasks.create_task(sender.run(connection))
                    tasks.create_task(connection.watch())
            except* (aiomqtt.MqttError, OSError, InputError) as failures:
                failure = next(_leaves(failures))
                context.missing["mqtt"] = f"broker {self._where}: {_reason(failure)}"
                self._log_problem(failure)
            counts.connected.set(0)
            if monotonic() - begin_s > STEADY_S:
                pause_s = RETRY_S
            await events.count()
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, MAX_RETRY_S)

    async def _introduce(self, connection: Connection, context: Context) -> None:
        """Say that the service is there, and describe its surfaces if that was asked for."""
        topic, topics = self._topics.status, self._topics
        try:
            await connection.tell((topic, ONLINE.encode()), content_type=properties(TEXT), retain=True)
            for surface in context.registry if self._settings.home_assistant_discovery else ():
                topic = discovery.topic(topics, surface.name)
                text = discovery.description(topics, surface.name)
                await connection.tell((topic, text), content_type=properties(JSON), retain=True)
        except RefusedError as error:
            message = f"it refuses messages to {topic} ({error}); allow this user to write there"
            raise RefusedError(message) from None
        if self._problem is None:
            _log.info("MQTT broker %s: connected; topics %s/...", self._where, self._settings.prefix)
        else:
            _log.info("MQTT broker %s: connected again after %.1f s", self._where, monotonic() - self._lost_s)
        self._problem = None

    def _log_problem(self, failure: BaseException) -> None:
        """Log why there is no connection: once per outage, and again if the broker refuses what it did not before."""
        is_first, is_refused = self._problem is None, isinstance(failure, MqttConnectError | RefusedError)
        if is_first:
            self._lost_s = monotonic()
        reason = _reason(failure)
        if is_first or (is_refused and reason != self._problem):
            _log.warning("MQTT broker %s: %s; the service goes on and tries again", self._where, reason)
            self._problem = reason


def _leaves(group: BaseExceptionGroup[BaseException]) -> Iterator[BaseException]:
    for one in group.exceptions:
        if isinstance(one, BaseExceptionGroup):
            yield from _leaves(one)
        else:
            yield one


def _reason(failure: BaseException) -> str:
    """Return why there is no connection, and what to do about it."""
    # The library names the reason of a lost connection only as the cause.
    cause = failure.__cause__ or failure
    code = getattr(cause, "rc", None)
    text = str(code) if isinstance(code, ReasonCode) else str(cause)
    if isinstance(cause, OSError) and not isinstance(cause, ssl.SSLError):
        # Errors of name resolution have negative numbers.
        text = os.strerror(cause.errno) if cause.errno and cause.errno > 0 else cause.strerror or ""
    return _WORDS.get(text, text)
