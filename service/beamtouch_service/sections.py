"""The sections of the configuration but for those of outputs, and the types of keys that all sections share."""

import re
from ipaddress import ip_network
from pathlib import Path
from ssl import SSLContext, SSLError
from typing import Annotated, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, ValidationInfo, model_validator

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import file_path
from beamtouch_common.hosts import host_name
from beamtouch_common.zones import MAX_ZONES, Zone, ZoneName


class Section(BaseModel):
    """A table of the configuration. Unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)


def _from_folder(path: Path, info: ValidationInfo) -> Path:
    """Return a path from the folder of the configuration, which the validation context has."""
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / file_path(path)


def _network(text: str) -> str:
    """Return the text of an IP address or a network; ValueError if it is none."""
    try:
        ip_network(text)
    except ValueError:
        raise ValueError("expected an address such as 10.0.0.5, or a network such as 10.0.0.0/24") from None
    return text


Port = Annotated[int, Field(ge=0, le=65535)]
Text = Annotated[str, Field(min_length=1)]
Host = Annotated[Text, AfterValidator(host_name)]
Network = Annotated[Text, AfterValidator(_network)]
File = Annotated[Path, Field(strict=False), AfterValidator(_from_folder)]
StaleMs = Annotated[FiniteFloat, Field(gt=0, le=60_000)]
_DATABASE = re.compile(r"postgresql://([^@/?#\s]*@)?[^@/?#\s]*/[^/?#\s]+(\?\S*)?")
"""With a second @, a part of the password would be taken for the host, and stand in the log."""


def require_readable(*paths: Path) -> None:
    """Raise FailedError for a file that cannot be read: it may come yet, as what is mounted late does."""
    for path in paths:
        try:
            path.open("rb").close()
        except OSError as error:
            raise FailedError(f"{path}: {error.strerror}") from None


def load_pair(context: SSLContext, certificate: Path, key: Path, advice: str) -> None:
    """Load a certificate and its key; raises FailedError, and InputError with this advice if they cannot be used."""
    require_readable(certificate, key)
    try:
        # An empty passphrase: otherwise OpenSSL would ask for one at the terminal and wait.
        context.load_cert_chain(certificate, key, password="")
    except SSLError:
        message = f"{certificate} and {key} are not a PEM certificate and its key without a passphrase; {advice}"
        raise InputError(message) from None


def require_pair(certificate: Path | None, key: Path | None, purpose: str) -> None:
    """Raise ValueError unless there are both files of a certificate, or none."""
    if (certificate is None) != (key is None):
        missing = "certificate_file" if certificate is None else "key_file"
        raise ValueError(f"{missing} is missing; {purpose} needs a certificate and its key")


class ServerSection(Section):
    """`[server]`: address, tokens, certificate, and limits."""

    host: Host = "127.0.0.1"
    """Address to listen on. Addresses beyond loopback require a write token and a read token."""
    port: Port = 8420
    """0 picks a free port."""
    write_token_file: File | None = None
    """File with the token required for writes. Without it, every write is refused."""
    read_token_file: File | None = None
    """File with the token required for reads. Without it, reads need no token."""
    admin_token_file: File | None = None
    """File with the token required for administration: commissioning, and the trail of changes. Without it, the write
    token administrates. A file of any of the three may have several tokens, each in a line `NAME TOKEN`."""
    certificate_file: File | None = None
    """PEM, with its chain. With `key_file`, the service speaks HTTPS instead of HTTP."""
    key_file: File | None = None
    """PEM, the private key of the certificate."""
    proxy: Host | None = None
    """Name or address of the proxy in front of a service that listens beyond loopback. Without one, the service warns:
    by itself it bounds neither the connections of one address nor slow requests."""
    trusted_proxies: Annotated[list[Network], Field(max_length=32)] = Field(default_factory=list)
    """Addresses or networks of proxies that are believed what they say of their clients: the user in the header
    `X-Forwarded-User`, and the address in `X-Forwarded-For`. Both stand in the trail of changes, and open nothing."""
    names: Annotated[list[Host], Field(max_length=32)] = Field(default_factory=list)
    """Names by which clients reach a service without a read token, beside its addresses, `localhost`, the name of its
    machine and names without a dot: that which a proxy passes on, for example. Others are refused, as a page from
    elsewhere could read the contacts by them. With a read token, or a certificate, any name will do."""
    replica: bool = False
    """This service is one of several that share the surfaces, behind a load balancer. Needs `events.url`."""
    max_streams: Annotated[int, Field(ge=0, le=1000)] = 32
    """Open streams. Further ones get 503."""


class EventsSection(Section):
    """`[events]`: the record of contacts."""

    file: File | None = None
    """SQLite file. Without it and `url`, events are kept in memory until the service stops."""
    url: Text | None = Field(None, repr=False)
    """PostgreSQL database, as postgresql://USER@HOST/NAME. Several services can share it."""
    keep_days: Annotated[FiniteFloat, Field(gt=0, le=36_500)] = 30.0
    """Age at which events are deleted, by the time in which services ran."""
    max_mb: Annotated[FiniteFloat, Field(ge=1, le=1e6)] | None = None
    """Size of the record. Beyond it, the oldest events are deleted. Default: 1200 in a file or a database, which holds
    a contact each 2 s for 30 days, and 100 in memory."""

    @property
    def largest_mb(self) -> float:
        """The size of the record beyond which events are deleted [MB]."""
        if self.max_mb is not None:
            return self.max_mb
        return 1200.0 if self.file or self.url else 100.0

    @model_validator(mode="after")
    def _name_one_place(self) -> Self:
        if self.url and self.file:
            raise ValueError("file and url are both given; events are in a file or in a database")
        if self.url and not _DATABASE.fullmatch(self.url):
            # Not at the field: a complaint there quotes the value, which may hold a password.
            message = "url must look like postgresql://beamtouch@127.0.0.1/beamtouch; in a password, write @ as %40"
            raise ValueError(message)
        return self


class SurfaceSection(Section):
    """`[surfaces.NAME]`: one surface."""

    model: File | None = None
    """Model file. Without it, the surface accepts samples but gives no contact."""
    stale_ms: StaleMs = 500.0
    """No contact is given from a sample older than this."""
    unexplained_after_s: Annotated[FiniteFloat, Field(gt=0, le=86_400)] = 10.0
    """A state `unexplained` that lasts longer raises a metric and writes a line to the log."""
    degraded_after_s: Annotated[FiniteFloat, Field(gt=0, le=86_400)] = 10.0
    """A channel that is missing, stuck, saturated or out of range for longer is out: the contact gets the note
    `degraded`, and log, metrics, MQTT status and `/health/ready?health=true` say so."""
    zones: Annotated[dict[ZoneName, Zone], Field(max_length=MAX_ZONES)] = Field(default_factory=dict)
    """Parts of the beam for which each contact is said to be inside or outside, in the order of their registers."""
