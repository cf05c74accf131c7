"""Messages to the broker: their topics, and their properties. Pure."""

from dataclasses import dataclass
from math import ceil

from paho.mqtt.client import MQTTMessage
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

JSON, TEXT = "application/json", "text/plain"
ONLINE, OFFLINE = "online", "offline"
"""Texts of the status: the service is connected to the broker, or not."""
READY = "ready"
"""The status of a surface that has a contact to give."""
OWNER = "beamtouch-service"
"""A property of each message that the broker keeps: the client identifier of the service that it is of."""
_UTF_8 = 1


@dataclass(frozen=True)
class Topics:
    """The topics below one prefix."""

    prefix: str

    @property
    def status(self) -> str:
        """Topic of the status of the service; the broker keeps its last message."""
        return f"{self.prefix}/status"

    def surface_status(self, surface: str) -> str:
        """Return the topic of the status of a surface; the broker keeps its last message."""
        return f"{self.prefix}/{surface}/status"

    def contact(self, surface: str) -> str:
        """Return the topic of the contacts on a surface."""
        return f"{self.prefix}/{surface}/contact"

    def event(self, surface: str) -> str:
        """Return the topic of the finished events of a surface."""
        return f"{self.prefix}/{surface}/event"


@dataclass(frozen=True)
class Kept:
    """A message that the broker keeps, as it tells a subscriber."""

    topic: str
    text: bytes
    """Empty: the broker is to forget the message."""
    owner: str | None
    """The client identifier of the service that it is of; None if it states none."""
    is_new: bool
    """True if it was sent just now, not before the subscription."""


def properties(content_type: str, stale_ms: float | None = None) -> Properties:
    """Return the properties of a message: the type of its text, and that the broker drops it after this limit of age.

    MQTT counts the limit in whole seconds, from 1 on.
    """
    made = _properties(PacketTypes.PUBLISH, content_type)
    if stale_ms is not None:
        made.MessageExpiryInterval = max(1, ceil(stale_ms / 1e3))
    return made


def kept_properties(content_type: str, owner: str, *, will: bool = False) -> Properties:
    """Return the properties of a message that the broker keeps, which may be the will of the service."""
    made = _properties(PacketTypes.WILLMESSAGE if will else PacketTypes.PUBLISH, content_type)
    made.UserProperty = [(OWNER, owner)]
    return made


def read_kept(message: MQTTMessage) -> Kept:
    """Return a message with its owner, from its properties."""
    pairs: list[tuple[str, str]] = getattr(message.properties, "UserProperty", [])
    return Kept(message.topic, bytes(message.payload), dict(pairs).get(OWNER), not message.retain)


def _properties(kind: int, content_type: str) -> Properties:
    made = Properties(kind)  # type: ignore[no-untyped-call]  # the library's
    made.PayloadFormatIndicator = _UTF_8
    made.ContentType = content_type
    return made
