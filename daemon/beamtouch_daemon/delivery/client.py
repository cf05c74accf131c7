"""HTTP client of the service: a verdict on each batch, and words for everything that keeps an answer away."""

import json
import os
import ssl
from dataclasses import dataclass
from enum import Enum
from http import HTTPStatus
from typing import Self

import aiohttp
from pydantic import ValidationError
from yarl import URL

from beamtouch_service.samples import Batch, Receipt

REQUEST_TIMEOUT_S = 2.0
MAX_DETAIL = 400
"""Longest explanation of the service in the log, in characters."""

PROBLEM = "urn:beamtouch:problem:"
TOO_LARGE = PROBLEM + "too-large"
OTHER_BEAM = PROBLEM + "other-beam"
INVALID_REQUEST = PROBLEM + "invalid-request"
NEVER_ACCEPTED = {TOO_LARGE, PROBLEM + "malformed-json", INVALID_REQUEST}
"""Types of problems with a batch. Only the service sends them, never a proxy in front of it."""


class UnreachableError(Exception):
    """There was no answer; the service may or may not have seen the request.

    Parameters
    ----------
    reason
        What happened, in a few words.
    advice
        What to change; empty if the service may just be away.
    """

    def __init__(self, reason: str, advice: str = "") -> None:
        super().__init__(reason)
        self.advice = advice


_NAME = "publish.url must have a name or address that the certificate states"
_TRUST = "publish.certificate_file must be the service's certificate, or that of its authority"
_CERTIFICATE_ADVICE = {
    9: "check the clock of this machine",  # X509_V_ERR_CERT_NOT_YET_VALID of OpenSSL
    10: "renew it, or check the clock of this machine",  # CERT_HAS_EXPIRED
    18: _TRUST,  # DEPTH_ZERO_SELF_SIGNED_CERT
    19: _TRUST,  # SELF_SIGNED_CERT_IN_CHAIN
    20: _TRUST,  # UNABLE_TO_GET_ISSUER_CERT_LOCALLY
    21: _TRUST,  # UNABLE_TO_VERIFY_LEAF_SIGNATURE
    62: _NAME,  # HOSTNAME_MISMATCH
    64: _NAME,  # IP_ADDRESS_MISMATCH
}


class Verdict(Enum):
    """Meaning of an answer for the batch."""

    TAKEN = "taken"
    LATER = "later"
    """The service, or a proxy in front of it, takes nothing now: try again."""
    REFUSED = "refused"
    """It takes none of these samples until something else changes: a token, a model, a configuration."""
    SMALLER = "smaller"
    """Some of the samples may be taken alone."""


@dataclass(frozen=True)
class Answer:
    """Answer of the service to a request."""

    status: int
    content: bytes

    @property
    def is_success(self) -> bool:
        """Whether the batch was taken."""
        return HTTPStatus.OK <= self.status < HTTPStatus.MULTIPLE_CHOICES

    @property
    def type(self) -> str:
        """Type of the problem; empty if the answer is not a problem of the service."""
        return str(self._problem.get("type", ""))

    @property
    def receipt(self) -> Receipt | None:
        """The receipt of a batch that was taken; None if it was not."""
        try:
            return Receipt.model_validate_json(self.content) if self.is_success else None
        except ValidationError:
            return None

    @property
    def is_of_service(self) -> bool:
        """Whether the service itself, and no proxy in front of it, says that these samples are wrong."""
        return self.type in NEVER_ACCEPTED

    @property
    def verdict(self) -> Verdict:
        """The verdict, by the type of the problem, because a bare status may come from a proxy."""
        if self.receipt is not None:
            return Verdict.TAKEN
        if self.status == HTTPStatus.REQUEST_ENTITY_TOO_LARGE or self.type in NEVER_ACCEPTED:
            return Verdict.SMALLER
        if self.type == OTHER_BEAM:
            return Verdict.REFUSED
        is_for_now = self.status in {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_MANY_REQUESTS}
        is_refusal = HTTPStatus.BAD_REQUEST <= self.status < HTTPStatus.INTERNAL_SERVER_ERROR and not is_for_now
        return Verdict.REFUSED if is_refusal else Verdict.LATER

    @property
    def explanation(self) -> str:
        """Status and explanation, in one line."""
        if self.is_success:
            return "the answer is no receipt; is publish.url the address of another program?"
        if self.status == HTTPStatus.UNAUTHORIZED:
            return "status 401: wrong token; correct publish.token_file and restart"
        detail = str(self._problem.get("detail", ""))[:MAX_DETAIL]
        return f"status {self.status}: {detail}" if detail else f"status {self.status}"

    @property
    def _problem(self) -> dict[str, object]:
        try:
            content = json.loads(self.content)
        except (ValueError, RecursionError):  # of another program
            return {}
        return content if isinstance(content, dict) else {}


class ServiceClient:
    """Client of the service at `url`, with a bearer token. Create it in the event loop, and close it.

    With https it trusts the given certificates (PEM), or those of the system. It ignores proxies in the environment
    and follows no redirects.
    """

    def __init__(self, url: str, token: str, certificates: str | None = None) -> None:
        self.url = url
        self._urls: dict[str, URL] = {}
        """Surface -> address for its samples."""
        trusted = ssl.create_default_context(cadata=certificates) if certificates is not None else True
        self._session = aiohttp.ClientSession(
            connector=aiohttp.TCPConnector(ssl=trusted),
            headers={"Authorization": f"Bearer {token}", "Content-Type": "application/json"},
            timeout=aiohttp.ClientTimeout(total=REQUEST_TIMEOUT_S),
            cookie_jar=aiohttp.DummyCookieJar(),
        )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def post_samples(self, surface: str, batch: Batch | None) -> Answer:
        """Send a batch, or nothing to see whether the service would take one; raises UnreachableError."""
        if surface not in self._urls:
            self._urls[surface] = self._url(f"/surfaces/{surface}/samples")
        content = b"{}" if batch is None else batch.model_dump_json(exclude_defaults=True).encode()
        return await self._request("POST", self._urls[surface], content)

    async def get(self, path: str) -> Answer:
        """Ask for a path; raises UnreachableError."""
        return await self._request("GET", self._url(path), None)

    def _url(self, path: str) -> URL:
        return URL(f"{self.url.rstrip('/')}{path}")

    async def _request(self, method: str, url: URL, content: bytes | None) -> Answer:
        try:
            async with self._session.request(method, url, data=content, allow_redirects=False) as response:
                return Answer(response.status, await response.read())
        except (aiohttp.ClientError, TimeoutError) as error:
            raise _unreachable(error) from error

    async def close(self) -> None:
        """Close the connection."""
        await self._session.close()


def _unreachable(error: aiohttp.ClientError | TimeoutError) -> UnreachableError:
    """Return the error that stands for one of aiohttp."""
    advice = ""
    match error:
        case TimeoutError():
            reason = "timeout"
        case aiohttp.ClientConnectorCertificateError(certificate_error=ssl.SSLCertVerificationError() as refused):
            reason = f"certificate refused: {refused.verify_message.rstrip('.')}"
            advice = _CERTIFICATE_ADVICE.get(refused.verify_code, "")
        case aiohttp.ClientConnectorSSLError():
            reason = "TLS failed"
            advice = "if the service has no certificate, publish.url must begin with http://"
        case aiohttp.ClientConnectorDNSError():
            reason = "no such host is known"
        case aiohttp.ClientConnectorError():
            reason = os.strerror(error.errno) if error.errno else "no connection"
        case aiohttp.ServerDisconnectedError() | aiohttp.ClientOSError() | aiohttp.ClientConnectionResetError():
            reason = "connection closed"
        case aiohttp.ClientPayloadError():
            reason = "the answer broke off"
        case aiohttp.ClientResponseError():
            reason = "the answer is not HTTP"
            advice = "is publish.url the address of another program?"
        case _:
            reason = type(error).__name__
    return UnreachableError(reason, advice)
