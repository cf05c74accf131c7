"""`[mqtt]` in the configuration."""

from typing import Annotated, ClassVar, Self

from pydantic import Field, FiniteFloat, model_validator

from beamtouch_service.outputs.section import OutputSection
from beamtouch_service.sections import File, Host, Text, require_pair


class MqttSection(OutputSection):
    """`[mqtt]`: contacts and events to an MQTT 5 broker. Without this section, the service knows no broker."""

    name: ClassVar[str] = "mqtt"
    module: ClassVar[str] = "beamtouch_service.outputs.mqtt.publisher"
    extra: ClassVar[str] = "mqtt"
    not_shared: ClassVar[str] = "as each service would send the events of all"

    host: Host
    """Name or address of the broker."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """Default: 1883, with TLS 8883."""
    prefix: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*$", max_length=200)] = "beamtouch"
    """Every topic begins with it. Each service at a broker needs a prefix of its own."""
    client_id: Annotated[str, Field(pattern=r"^[ -~]{1,200}$")] | None = None
    """Identifier at the broker. Default: the prefix."""
    max_rate_hz: Annotated[FiniteFloat, Field(ge=1, le=200)] = 20.0
    """Contacts per second and surface while the state does not change."""
    username: Text | None = None
    """User at the broker. Default: no user."""
    password_file: File | None = None
    """File with the password of `username`."""
    tls: bool = False
    """Encrypt the connection and check the broker's certificate."""
    ca_file: File | None = None
    """PEM, the certificates that are trusted. Default: those of the system."""
    certificate_file: File | None = None
    """PEM, the certificate of this client, for brokers that ask for one."""
    key_file: File | None = None
    """PEM, the private key of the certificate."""
    send_recorded_events: bool = False
    """Also send a new broker the events that were recorded before."""
    home_assistant_discovery: bool = False
    """Describe each surface to Home Assistant."""

    @model_validator(mode="after")
    def _require_what_keys_need(self) -> Self:
        require_pair(self.certificate_file, self.key_file, "a client certificate")
        if (self.ca_file or self.certificate_file) and not self.tls:
            key = "ca_file" if self.ca_file else "certificate_file"
            raise ValueError(f"{key} has no effect without TLS; set tls = true")
        if self.password_file and not self.username:
            raise ValueError("password_file has no effect without a user; set username")
        return self

    @property
    def broker_port(self) -> int:
        """The port of the broker, stated or by default."""
        return self.port or (8883 if self.tls else 1883)
