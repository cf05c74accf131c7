"""HTTP client of the service: a verdict on each batch, and words for everything that keeps an answer away."""

import logging
import os
import socket
import ssl
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from time import monotonic
from typing import Any, Self, TypeVar

import aiohttp
from pydantic import BaseModel, ValidationError

from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.delivery.pace import TIMEOUT_S
from beamtouch_service.samples import Batch, Receipt

MAX_DETAIL = 400
"""Longest explanation of the service in the log, in characters."""

PROBLEM = "urn:beamtouch:problem:"
TOO_LARGE = PROBLEM + "too-large"
OTHER_BEAM = PROBLEM + "other-beam"
INVALID_REQUEST = PROBLEM + "invalid-request"
NOT_FOUND = PROBLEM + "not-found"
NEVER_ACCEPTED = {TOO_LARGE, PROBLEM + "malformed-json", INVALID_REQUEST}
"""Types of problems with a batch. Only the service sends them, never a proxy in front of it."""
_logger = logging.getLogger(__name__)
_T = TypeVar("_T", bound=BaseModel)


class UnreachableError(Exception):
    """There was no answer, for a reason in a few words; the service may or may not have seen the request."""

    def __init__(self, reason: str, advice: str = "") -> None:
        super().__init__(reason)
        self.advice = advice
        """Advice on a setting to change; empty if the service may just be away."""


class Verdict(Enum):
    """Meaning of an answer for the batch."""

    TAKEN = "taken"
    LATER = "later"
    """The service, or a proxy in front of it, takes nothing now: try again."""
    REFUSED = "refused"
    """It takes none of these samples until something else changes: a token, a model, a configuration."""
    SMALLER = "smaller"
    """Some of the samples may be taken alone."""


class _Problem(BaseModel):
    """The members of a problem of the service that are used here."""

    type: str = ""
    detail: str = ""


@dataclass(frozen=True)
class ServiceAnswer:
    """Answer of the service, or of another program, to a request."""

    status: int
    content: bytes

    @property
    def is_success(self) -> bool:
        """True if the request was answered as it should be."""
        return 200 <= self.status < 300

    @cached_property
    def receipt(self) -> Receipt | None:
        """The receipt of a batch that was taken; None if it was not."""
        return self.parsed(Receipt) if self.is_success else None

    @property
    def problem(self) -> str:
        """Type of the problem; empty if the answer is not a problem of the service."""
        return (self.parsed(_Problem) or _Problem()).type

    @property
    def verdict(self) -> Verdict:
        """The verdict, by the type of the problem, because a bare status may come from a proxy."""
        if self.receipt is not None:
            return Verdict.TAKEN
        if self.status == 413 or self.problem in NEVER_ACCEPTED:
            return Verdict.SMALLER
        is_refusal = 400 <= self.status < 500 and self.status not in {408, 429}  # a timeout, too many requests
        return Verdict.REFUSED if is_refusal or self.problem == OTHER_BEAM else Verdict.LATER

    @property
    def explanation(self) -> str:
        """Status and explanation, in one line."""
        if self.is_success:
            return "the answer is no receipt; is publish.url the address of another program?"
        if self.status == 401:
            return "status 401: wrong token; correct publish.token_file and restart"
        if self.status == 404 and self.problem in {"", NOT_FOUND}:
            return "status 404: no service is there; is the path in publish.url the one that the proxy passes on?"
        detail = (self.parsed(_Problem) or _Problem()).detail[:MAX_DETAIL]
        return f"status {self.status}: {detail}" if detail else f"status {self.status}"

    def parsed(self, model: type[_T]) -> _T | None:
        """Return the content as a model; None if it is something else."""
        try:
            return model.model_validate_json(self.content)
        except ValidationError:
            return None


class ServiceClient:
    """Client of the service at `url`, with a bearer token. Use it as a context manager, in the event loop.

    With https it trusts what `trusted` does, or the certificates of the system. It ignores proxies in the environment
    and follows no redirects.
    """

    def __init__(self, url: str, token: str, trusted: ssl.SSLContext | None = None) -> None:
        self.url = url
        self._session = aiohttp.ClientSession(
            # No request waits for another one here; each surface has few at a time.
            connector=aiohttp.TCPConnector(ssl=trusted or True, limit=0, socket_factory=_socket),
            headers={"Authorization": f"Bearer {token}", "Content-Type": "application/json"},
            skip_auto_headers=["Accept", "Accept-Encoding", "User-Agent"],
            cookie_jar=aiohttp.DummyCookieJar(),
        )

    @classmethod
    def of(cls, config: Config) -> Self:
        """Return the client of a configuration; raises what `Config.read_token` and `Config.read_trust` raise."""
        return cls(config.publish.url, config.read_token(), config.read_trust())

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._session.close()

    async def post_samples(self, surface: str, batch: Batch | None, timeout_s: float = TIMEOUT_S) -> ServiceAnswer:
        """Send a batch, or nothing to see whether the service would take one; raises UnreachableError."""
        path = f"/surfaces/{surface}/samples"
        if batch is None:
            return await self._request("POST", path, b"{}")
        content = compress(batch.model_dump_json(exclude_defaults=True).encode())
        return await self._request("POST", path, content, {"Content-Encoding": "gzip"}, timeout_s)

    async def get(self, path: str) -> ServiceAnswer:
        """Ask for a path; raises UnreachableError."""
        return await self._request("GET", path, None)

    async def _request(
        self,
        method: str,
        path: str,
        content: bytes | None,
        headers: Mapping[str, str] | None = None,
        timeout_s: float = TIMEOUT_S,
    ) -> ServiceAnswer:
        url, begun_s = f"{self.url.rstrip('/')}{path}", monotonic()
        _logger.debug("%s %s with %d bytes", method, url, len(content or b""))
        try:
            async with self._session.request(
                method,
                url,
                data=content,
                headers=headers,
                allow_redirects=False,
                timeout=aiohttp.ClientTimeout(total=timeout_s),
            ) as response:
                answer = ServiceAnswer(response.status, await response.read())
        except (aiohttp.ClientError, TimeoutError) as error:
            why = _unreachable(error)
            _logger.debug("%s %s: no answer after %.0f ms: %s", method, url, (monotonic() - begun_s) * 1e3, why)
            raise why from error
        if _logger.isEnabledFor(logging.DEBUG):
            words = f" ({answer.explanation})" if not answer.is_success else ""
            took_ms = (monotonic() - begun_s) * 1e3
            _logger.debug("%s %s: status %d after %.1f ms%s", method, url, answer.status, took_ms, words)
        return answer


def _socket(address: tuple[Any, ...]) -> socket.socket:
    """Return a socket that forgets what it has not sent when it is closed.

    Otherwise the system would go on sending requests that were given up, before those that are of use.
    """
    family, kind, protocol, *_ = address
    made = socket.socket(family, kind, protocol)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    return made


def compress(content: bytes) -> bytes:
    """Return content as gzip. This level takes 3 us for a sample of four channels, and 5 % more bytes than the best."""
    encoder = zlib.compressobj(level=4, wbits=16 + zlib.MAX_WBITS)
    return encoder.compress(content) + encoder.flush()


def _unreachable(error: aiohttp.ClientError | TimeoutError) -> UnreachableError:
    """Return the error that stands for one of aiohttp."""
    advice = ""
    match error:
        case TimeoutError():
            reason = "timeout"
        case aiohttp.ClientConnectorCertificateError(certificate_error=ssl.SSLCertVerificationError() as refused):
            reason = f"certificate refused: {refused.verify_message.rstrip('.')}"
            advice = _certificate_advice(refused.verify_code)
        case aiohttp.ClientConnectorSSLError():
            reason = "TLS failed"
            advice = "if the service has no certificate, publish.url must begin with http://"
        case aiohttp.ClientConnectorDNSError():
            reason = "no such host is known"
        case aiohttp.ClientConnectorError():
            reason = os.strerror(error.errno) if error.errno else "no connection"
        case aiohttp.ClientPayloadError():
            reason = "the answer broke off"
        case aiohttp.ClientResponseError():
            reason = "the answer is not HTTP"
            advice = "is publish.url the address of another program?"
        case _:
            reason = "connection closed"
    return UnreachableError(reason, advice)


def _certificate_advice(code: int) -> str:
    """Return what to change, by OpenSSL's code for what is wrong with a certificate."""
    if code in {9, 10}:  # not yet valid, expired
        return "renew it, or check the clock of this machine"
    if code in {62, 64}:  # for another name, for another address
        return "publish.url must have a name or address that the certificate states"
    return "publish.certificate_file must be the service's certificate, or that of its authority"
