"""The properties of messages: what their text is, and how long the broker may keep them."""

from math import ceil

from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

JSON, TEXT = "application/json", "text/plain"
_UTF_8 = 1


def properties(content_type: str, expiry_s: int | None = None) -> Properties:
    """Return the properties of a message: the type of its text, and how long the broker may keep it [s]."""
    made = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]  # the library's
    made.PayloadFormatIndicator = _UTF_8
    made.ContentType = content_type
    if expiry_s is not None:
        made.MessageExpiryInterval = expiry_s
    return made


def expiry_s(stale_ms: float) -> int:
    """Return the expiry of contacts with this limit of age. MQTT counts it in whole seconds, from 1 on."""
    return max(1, ceil(stale_ms / 1e3))
