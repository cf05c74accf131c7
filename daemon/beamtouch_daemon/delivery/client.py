"""HTTP to the service: one connection that is kept, and the answers in the words of the publisher."""

import json
import ssl
from dataclasses import dataclass
from enum import Enum
from http import HTTPStatus
from typing import Self

import aiohttp
from yarl import URL

REQUEST_TIMEOUT_S = 2.0
MAX_DETAIL = 200
"""Characters of the service's explanation in the log."""


PROBLEM = "urn:beamtouch:problem:"
TOO_LARGE = PROBLEM + "too-large"
MISSING_CHANNELS = PROBLEM + "missing-channels"
NEVER_ACCEPTED = {PROBLEM + "malformed-json", PROBLEM + "invalid-request"}
"""Types of problems that decide what becomes of a batch; only the service sends them, and no proxy before it."""


class Verdict(Enum):
    """What an answer means for the batch."""

    TAKEN = "taken"
    LATER = "later"
    """The service, or something before it, takes nothing now: the same batch again after a while."""
    UNFIT = "unfit"
    """It does not fit the model that the surface has now; others may."""
    ODD = "odd"
    """An answer that nobody foresaw; it may be about this batch or about all of them."""
    TOO_LARGE = "too large"
    """Part of it may be taken."""
    NEVER = "never"
    """It is no batch to the service, and never will be."""


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


class UnreachableError(Exception):
    """There was no answer; whether the service has seen the request is not known."""


@dataclass(frozen=True)
class Answer:
    """What the service says to a batch."""

    status: int
    content: bytes

    @property
    def is_success(self) -> bool:
        """Whether the batch was taken."""
        return HTTPStatus.OK <= self.status < HTTPStatus.MULTIPLE_CHOICES

    @property
    def type(self) -> str:
        """The type of the problem; empty where it is none of the service."""
        return str(self._problem.get("type", ""))

    @property
    def verdict(self) -> Verdict:
        """What becomes of the batch: by the type of the problem, as a status may also be that of a proxy."""
        if self.is_success:
            return Verdict.TAKEN
        if self.status == HTTPStatus.REQUEST_ENTITY_TOO_LARGE:
            return Verdict.TOO_LARGE
        if self.type == MISSING_CHANNELS:
            return Verdict.UNFIT
        if self.type in NEVER_ACCEPTED:
            return Verdict.NEVER
        takes_nothing = self.status in _TAKES_NOTHING or self.status < HTTPStatus.BAD_REQUEST
        return Verdict.LATER if takes_nothing else Verdict.ODD

    @property
    def explanation(self) -> str:
        """The status and what the service says of it, in one line."""
        if self.status == HTTPStatus.UNAUTHORIZED:
            return "status 401: wrong token; correct publish.token_file and restart"
        detail = str(self._problem.get("detail", ""))[:MAX_DETAIL]
        return f"status {self.status}: {detail}" if detail else f"status {self.status}"

    @property
    def _problem(self) -> dict[str, object]:
        try:
            content = json.loads(self.content)
        except ValueError:
            return {}
        return content if isinstance(content, dict) else {}


class ServiceClient:
    """A client of the service at `url` that shows `token`; made while the event loop runs, and to be closed.

    Over https it trusts these certificates (PEM), or without any those of the system. Proxies in the environment are
    not for it, and it goes nowhere but to this address.
    """

    def __init__(self, url: str, token: str, certificates: str | None = None) -> None:
        self.url = url
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
        url = URL(f"{self.url.rstrip('/')}/surfaces/{surface}/samples")
        try:
            async with self._session.post(url, data=batch, allow_redirects=False) as response:
                return Answer(response.status, await response.read())
        except (aiohttp.ClientError, TimeoutError) as error:
            raise UnreachableError(type(error).__name__) from error

    async def close(self) -> None:
        """Close the connection."""
        await self._session.close()
