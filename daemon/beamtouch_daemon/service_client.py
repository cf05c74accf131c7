"""HTTP to the service: one connection that is kept, and the answers in the words of the publisher."""

import json
import ssl
from dataclasses import dataclass
from http import HTTPStatus
from typing import Self

import aiohttp
from yarl import URL

REQUEST_TIMEOUT_S = 2.0
MAX_DETAIL = 200
"""Characters of the service's explanation in the log."""


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
    def explanation(self) -> str:
        """The status and what the service says of it, in one line."""
        if self.status == HTTPStatus.UNAUTHORIZED:
            return "status 401: wrong token; correct publish.token_file and restart"
        try:
            detail = str(json.loads(self.content)["detail"])[:MAX_DETAIL]
        except (ValueError, KeyError, TypeError):
            return f"status {self.status}"
        return f"status {self.status}: {detail}"


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
