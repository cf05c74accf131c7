"""What the service counts of its messages to the broker, for `GET /metrics`."""

from prometheus_client import CollectorRegistry, Counter, Gauge


class MqttCounts:
    """Counts since the start."""

    def __init__(self, registry: CollectorRegistry) -> None:
        words = "1 while the MQTT broker answers."
        self.connected = Gauge("beamtouch_mqtt_connected", words, registry=registry)
        sent = Counter("beamtouch_mqtt_messages", "Messages sent to the MQTT broker.", ["kind"], registry=registry)
        self.contacts = sent.labels("contact")
        self.events = sent.labels("event")
        """Those that the broker acknowledged."""
        words = "Contacts that were due but not sent, because the MQTT broker did not answer before they were too old."
        self.dropped = Counter("beamtouch_mqtt_contacts_dropped", words, registry=registry)
        words = "Finished events that the MQTT broker has yet to acknowledge."
        self.pending = Gauge("beamtouch_mqtt_events_pending", words, registry=registry)
