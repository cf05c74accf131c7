"""Who asks: the name of the token, the address, and the user that a trusted proxy names. Pure.

A header can be written by anyone who reaches the service. So the address and the user that a proxy states are believed
only if the connection comes from one of the addresses of `server.trusted_proxies`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from ipaddress import ip_address, ip_network

SERVICE = "service"
"""Who did what no request asked for, on the trail. No token and no user has this name."""
USER_HEADER = b"x-forwarded-user"
_ADDRESS_HEADER = b"x-forwarded-for"
_MAX_NAME = 80
"""Length of the longest name of a user, and of the longest address."""
Headers = Iterable[tuple[bytes, bytes]]


@dataclass(frozen=True)
class Caller:
    """Who sent a request, as far as the service can tell."""

    token: str
    """Name of the token; empty if the request needed none."""
    address: str
    user: str | None = None
    """The user that a trusted proxy names; None without one."""

    @property
    def name(self) -> str:
        """The user, or else the name of the token."""
        return self.user or self.token


class TrustedProxies:
    """The proxies whose statements about their clients are believed."""

    def __init__(self, networks: Sequence[str] = ()) -> None:
        self._networks = [ip_network(network) for network in networks]

    def find_caller(self, token: str, peer: str, headers: Headers) -> Caller:
        """Return who sent a request with these headers over a connection from `peer`."""
        if not self._trusts(peer):
            return Caller(token, peer)
        stated = list(headers)
        users = [value for name, value in stated if name == USER_HEADER]
        addresses = [value for name, value in stated if name == _ADDRESS_HEADER]
        # The last address is that of the proxy's own client; those before it are what the client says.
        address = _shown(addresses[-1].rpartition(b",")[2]) if addresses else ""
        # Two headers: one of them is the client's, and nobody knows which.
        user = _shown(users[0]) if len(users) == 1 else ""
        is_named = user and user.casefold() != SERVICE
        return Caller(token, address or peer, user if is_named else None)

    def _trusts(self, peer: str) -> bool:
        try:
            address = ip_address(peer)
        except ValueError:
            return False
        # A service that listens on :: sees clients of IPv4 as ::ffff:10.0.0.5.
        address = getattr(address, "ipv4_mapped", None) or address
        return any(address in network for network in self._networks)


def _shown(value: bytes) -> str:
    return one_line(value.decode("utf-8", "replace"))[:_MAX_NAME]


def one_line(text: str) -> str:
    """Return text without what could forge or hide lines where it is printed."""
    return " ".join("".join(one if one.isprintable() else " " for one in text).split())
