"""Properties of the messages to a broker."""

import pytest

from beamtouch_service.outputs.mqtt.messages import JSON, properties


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "Each contact also has a message expiry: the limit of the surface, rounded up to whole seconds.",
)
@pytest.mark.parametrize(("stale_ms", "expiry_s"), [(1.0, 1), (500.0, 1), (1000.0, 1), (1001.0, 2), (60_000.0, 60)])
def test_a_contact_expires_at_the_broker_with_the_limit_of_its_surface(stale_ms: float, expiry_s: int) -> None:
    assert vars(properties(JSON, stale_ms))["MessageExpiryInterval"] == expiry_s


def test_an_event_does_not_expire() -> None:
    assert "MessageExpiryInterval" not in vars(properties(JSON))
