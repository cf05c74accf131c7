"""The address of a host. One question to the name server at a time."""

import asyncio
from contextlib import suppress
from ipaddress import ip_address
from socket import SOCK_STREAM, gaierror
from typing import Any


class UnknownHostError(OSError):
    """The name of a host does not resolve; the text is one line for the log."""


class HostAddress:
    """The address of a host. Each attempt waits for the same question to the name server.

    A name server that is away keeps a thread busy for many seconds: of one question each, the others need theirs.
    """

    def __init__(self, host: str, port: int) -> None:
        self.port = port
        self._host = host
        self._lookup: asyncio.Future[list[Any]] | None = None
        """The running question."""

    async def resolve(self, within_s: float) -> str:
        """Return the address; UnknownHostError if the name does not resolve in time."""
        with suppress(ValueError):
            return str(ip_address(self._host))
        if self._lookup is None:
            loop = asyncio.get_running_loop()
            self._lookup = asyncio.ensure_future(loop.getaddrinfo(self._host, self.port, type=SOCK_STREAM))
        lookup, advice = self._lookup, "is the name right, and is its name server there?"
        try:
            async with asyncio.timeout(within_s):
                (_, _, _, _, address), *_ = await asyncio.shield(lookup)
        except TimeoutError:
            raise UnknownHostError(
                f"{self._host} does not resolve (the name server does not answer); {advice}"
            ) from None
        except gaierror as error:
            raise UnknownHostError(f"{self._host} does not resolve ({error.strerror}); {advice}") from None
        finally:
            self._lookup = None if lookup.done() else lookup
        return str(address[0])

    def __str__(self) -> str:
        return f"[{self._host}]:{self.port}" if ":" in self._host else f"{self._host}:{self.port}"


def no_connection(address: object) -> str:
    """Return what to say if there is no connection to HOST:PORT."""
    return f"no connection to {address}; is the device on, and is the address right?"
