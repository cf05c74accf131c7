"""Settings of the service that receives the samples, and the files that they name."""

import re
import ssl
from pathlib import Path
from typing import Annotated
from urllib.parse import SplitResult, urlsplit

from pydantic import AfterValidator, Field, FiniteFloat

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.hosts import host_name
from beamtouch_daemon.config.sources import RelativePath, Strict

_PATH = re.compile(r"(/(?!\.\.?(/|$))([A-Za-z0-9._~!$&'()*+,;=:@-]|%[0-9A-Fa-f]{2})+)*/?")
_ROUTES = {"contact", "events", "samples", "stream", "surfaces"}
"""Ends of an address that was copied from a page or an example."""


def _http_url(value: str) -> str:
    parts = urlsplit(value)
    if parts.scheme not in {"http", "https"} or not parts.hostname or parts.query or parts.fragment or not _port(parts):
        raise ValueError("must look like http://127.0.0.1:8420")
    if parts.username is not None:
        raise ValueError("must name no user; the service knows the daemon by its token")
    if not _PATH.fullmatch(parts.path):
        raise ValueError("must have a path like /beamtouch, or none")
    if (last := parts.path.rstrip("/").rpartition("/")[2]) in _ROUTES:
        raise ValueError(f"must be the address of the whole service: leave out /{last} and what belongs to it")
    host_name(parts.hostname)
    return value.rstrip("/")


def _port(parts: SplitResult) -> int:
    """Return the port of an address, by default that of HTTP; 0 if it has a wrong one."""
    try:
        return 80 if parts.port is None else parts.port
    except ValueError:
        return 0


HttpUrl = Annotated[str, AfterValidator(_http_url)]
"""Address of a service; with a path if a proxy serves it below one."""


class Publish(Strict):
    """The service that receives the samples, and the buffers in front of it."""

    url: HttpUrl
    """Address of the service, such as `http://127.0.0.1:8420`; with a path if a proxy serves it below one, as in
    `https://plant.example/beamtouch`."""
    token_file: RelativePath
    """File with the service's bearer token and nothing else."""
    certificate_file: RelativePath | None = None
    """Certificates to trust with https (PEM); default: those of the system."""
    batch_ms: Annotated[FiniteFloat, Field(ge=1, le=10_000)] = 4.0
    """Longest time to collect samples for one request."""
    rest_ms: Annotated[FiniteFloat, Field(ge=0, le=10_000)] = 100.0
    """Time from one sample to the next while nothing changes, at most a fifth of `stale_ms` of the service. The first
    reading that leaves what the mean explains ends that, and the readings that waited become samples too. 0: a sample
    for each reading always."""
    log_samples: Annotated[int, Field(ge=100, le=10_000_000)] = 20_000
    """Limit of the samples per surface in memory that the record of the service does not have yet; beyond it the oldest
    are dropped and counted."""
    log_file: RelativePath = Path("beamtouch-daemon.samples")
    """Keeps such samples on disk after 5 s, and over a restart. The zeros of the last rest are kept beside it."""
    log_mb: Annotated[FiniteFloat, Field(ge=0, le=100_000)] = 200.0
    """Limit of the size of that file; beyond it the oldest samples are dropped and counted. 0: neither file."""


def trust(path: Path) -> ssl.SSLContext:
    """Return a context that trusts the certificates in a file (PEM).

    InputError if they cannot be used; FailedError if the file cannot be read, as it may come later.
    """
    try:
        return ssl.create_default_context(cafile=path)
    except ssl.SSLError as error:
        raise InputError(f"publish.certificate_file: {path} contains no PEM certificate; name the service's") from error
    except OSError as error:
        raise FailedError(f"publish.certificate_file: cannot read {path} ({error.strerror})") from error
