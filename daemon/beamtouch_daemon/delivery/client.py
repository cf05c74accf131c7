"""HTTP client of the service: one persistent connection, and a verdict on each batch."""

import json
import ssl
from dataclasses import dataclass
from enum import Enum
from http import HTTPStatus
from typing import Self

import aiohttp
from yarl import URL

from beamtouch_daemon.delivery.unreachable import unreachable

REQUEST_TIMEOUT_S = 2.0
MAX_DETAIL = 400
"""Longest explanation of the service in the log, in characters."""

PROBLEM = "urn:beamtouch:problem:"
TOO_LARGE = PROBLEM + "too-large"
MISSING_CHANNELS = PROBLEM + "missing-channels"
OTHER_BEAM = PROBLEM + "other-beam"
INVALID_REQUEST = PROBLEM + "invalid-request"
NEVER_ACCEPTED = {PROBLEM + "malformed-json", INVALID_REQUEST}
"""Problem types that decide the fate of a batch. Only the service sends them, never a proxy in front of it."""


class Verdict(Enum):
    """Meaning of an answer for the batch."""

    TAKEN = "taken"
    LATER = "later"
    """The service, or a proxy in front of it, takes nothing now: send the same batch again later."""
    UNFIT = "unfit"
    """The batch does not fit the surface's current model; other batches may."""
    ODD = "odd"
    """Unexpected answer, which may concern this batch or all batches."""
    TOO_LARGE = "too large"
    """Smaller parts of the batch may be taken."""
    NEVER = "never"
    """The service will never take this batch."""


_TAKES_NOTHING = {
    HTTPStatus.UNAUTHORIZED,
    HTTPStatus.FORBIDDEN,
    HTTPStatus.NOT_FOUND,
    HTTPStatus.METHOD_NOT_ALLOWED,
    HTTPStatus.PROXY_AUTHENTICATION_REQUIRED,
    HTTPStatus.REQUEST_TIMEOUT,
    HTTPStatus.TOO_MANY_REQUESTS,
    HTTPStatus.BAD_GATEWAY,
    HTTPStatus.SERVICE_UNAVAILABLE,
    HTTPStatus.GATEWAY_TIMEOUT,
}


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
    def verdict(self) -> Verdict:
        """The verdict, by the type of the problem, because a bare status may come from a proxy."""
        if self.is_success:
            return Verdict.TAKEN
        if self.status == HTTPStatus.REQUEST_ENTITY_TOO_LARGE:
            return Verdict.TOO_LARGE
        if self.type in {MISSING_CHANNELS, OTHER_BEAM}:
            return Verdict.UNFIT
        if self.type in NEVER_ACCEPTED:
            return Verdict.NEVER
        takes_nothing = self.status in _TAKES_NOTHING or self.status < HTTPStatus.BAD_REQUEST
        return Verdict.LATER if takes_nothing else Verdict.ODD

    @property
    def explanation(self) -> str:
        """Status and explanation, in one line."""
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

    async def post_samples(self, surface: str, batch: bytes) -> Answer:
        """Send a batch as JSON; raises UnreachableError."""
        if surface not in self._urls:
            self._urls[surface] = self._url(f"/surfaces/{surface}/samples")
        return await self._request("POST", self._urls[surface], batch)

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
            raise unreachable(error) from error

    async def close(self) -> None:
        """Close the connection."""
        await self._session.close()
