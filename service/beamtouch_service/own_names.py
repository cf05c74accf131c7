"""The names by which clients may ask a service that gives its answers without a token. Pure.

A page from elsewhere can let its own name point to this machine (DNS rebinding). The browser then takes the service for
a part of that page, which reads what it answers. What the browser cannot hide is the name that it asked for: `Host`.
"""

from collections.abc import Iterable
from functools import lru_cache
from ipaddress import ip_address
from urllib.parse import urlsplit

from beamtouch_service.problems import Kind, Problem, ProblemError

_SHOWN = 100
"""Length of the longest name that an answer repeats."""


class OwnNames:
    """The names of one service."""

    def __init__(self, names: Iterable[str]) -> None:
        """`names` are further ones beside addresses, `localhost`, and names without a dot: nobody outside has those."""
        self._names = frozenset(name.rstrip(".").lower() for name in names)
        self._is_own = lru_cache(maxsize=64)(self._find)

    def require(self, headers: Iterable[tuple[bytes, bytes]]) -> None:
        """Let a request with these headers pass; raises ProblemError (421) if it asks for a foreign name.

        A request without a name passes, such as that of a health check: browsers always send one.
        """
        for name, value in headers:
            if name == b"host" and not self._is_own(value):
                raise ProblemError(Problem(Kind.OTHER_NAME, _refusal(value)))

    def _find(self, host: bytes) -> bool:
        name = _name_in(host)
        return name is not None and ("." not in name or name.endswith(".localhost") or name in self._names)


def _name_in(host: bytes) -> str | None:
    """Return the name in a `Host`, without its port; empty for an address or nothing, None if it is neither."""
    if not host:
        return ""
    try:
        name = (urlsplit(f"//{host.decode('ascii')}").hostname or "").rstrip(".").lower()
    except ValueError:
        return None
    try:
        ip_address(name.partition("%")[0])
    except ValueError:
        return name or None
    return ""


def _refusal(host: bytes) -> str:
    shown = host.decode("ascii", "replace")[:_SHOWN]
    advice = "Ask for its address or for localhost; if the name is right, add it to server.names."
    return f"This service does not go by the name {shown!r}. {advice} With a read token, any name will do."
