"""Names and addresses of hosts."""

from ipaddress import ip_address
from urllib.parse import urlsplit

_NOT_IN_NAMES = frozenset(" :/\\@[]?#*,")
"""Characters that separate the host from the rest of an address, or that join several hosts."""


def host_name(text: str) -> str:
    """Return the name or address of a host; ValueError if no host can have it."""
    if not (_is_address(text) or _is_name(text)):
        raise ValueError("must be the name or address of a host, such as 192.168.0.20")
    return text


def tcp_address(text: str) -> tuple[str, int | None]:
    """Return host and port of tcp://HOST[:PORT], None without a port; ValueError if it is something else."""
    parts = urlsplit(text)
    port = parts.port
    if parts.scheme != "tcp" or parts.path.strip("/") or parts.query or port == 0:
        raise ValueError("must be tcp://HOST:PORT")
    return host_name(parts.hostname or ""), port


def _is_address(text: str) -> bool:
    try:
        ip_address(text)
    except ValueError:
        return False
    return True


def _is_name(text: str) -> bool:
    """Return whether this can be a name. A name with a port, or a whole URL, is none."""
    try:
        text.encode("idna")
    except UnicodeError:
        return False
    return bool(text) and text.isprintable() and _NOT_IN_NAMES.isdisjoint(text)
