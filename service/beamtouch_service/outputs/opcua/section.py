"""`[opcua]` in the configuration."""

from typing import Annotated, ClassVar, Self

from pydantic import Field, FiniteFloat, model_validator

from beamtouch_service.outputs.section import OutputSection
from beamtouch_service.sections import File, Host, Text, require_pair


class OpcUaSection(OutputSection):
    """`[opcua]`: contacts and events over OPC UA. Without this section, there is no OPC UA server."""

    name: ClassVar[str] = "opcua"
    module: ClassVar[str] = "beamtouch_service.outputs.opcua.server"
    extra: ClassVar[str] = "opcua"
    not_shared: ClassVar[str] = "as each service would send the events of all"

    host: Host = "127.0.0.1"
    """Address to listen on. Addresses beyond loopback require a certificate and a user."""
    port: Annotated[int, Field(ge=1, le=65535)] = 4840
    """Port to listen on."""
    interval_ms: Annotated[FiniteFloat, Field(ge=10, le=10_000)] = 100.0
    """Clients that have subscribed are told of new samples in turns of this time. A read is answered with the contact
    of its moment."""
    certificate_file: File | None = None
    """PEM or DER. With `key_file`, clients must sign and encrypt."""
    key_file: File | None = None
    """PEM or DER, the private key of the certificate."""
    trusted_folder: File | None = None
    """Folder with the certificates of the clients that may connect, PEM or DER. Default: every client."""
    username: Text | None = None
    """The only user. Default: everybody on this machine may read."""
    password_file: File | None = None
    """File with the password of `username`."""

    @model_validator(mode="after")
    def _require_what_keys_need(self) -> Self:
        require_pair(self.certificate_file, self.key_file, "an encrypted connection")
        if self.trusted_folder and not self.certificate_file:
            raise ValueError("trusted_folder has no effect without a certificate of the server; set certificate_file")
        if (self.username is None) != (self.password_file is None):
            missing = "username" if self.username is None else "password_file"
            raise ValueError(f"{missing} is missing; a user needs a name and a password")
        return self
