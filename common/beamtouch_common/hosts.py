"""Names and addresses of hosts."""

import re
from ipaddress import ip_address

_FOREIGN = re.compile(r"[\s/@?#]")
"""Parts of an address on the web that are no part of a host's name."""


def host_name(text: str) -> str:
    """Return the name or address of a host; ValueError if no host can have it."""
    try:
        text.encode("idna")
    except UnicodeError:
        is_name = False
    else:
        is_name = bool(text) and text.isprintable() and not _FOREIGN.search(text)
    if not is_name or (":" in text and not _is_address(text)):
        message = "must be the name or address of a host, such as 192.168.0.20"
        raise ValueError(message)
    return text


def _is_address(text: str) -> bool:
    try:
        ip_address(text)
    except ValueError:
        return False
    return True
