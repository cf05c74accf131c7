"""The address to listen on."""

import socket

from beamtouch_common.listening import remedy
from beamtouch_service.config import ConfigError

_SEND_BUFFER_BYTES = 128 * 1024


def resolve(host: str) -> tuple[socket.AddressFamily, str]:
    """Return family and numeric address of a host, preferably IPv4; raises ConfigError if it has none."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        message = (
            f"host {host!r} is not an address of this machine; use 127.0.0.1, or an address that `ip address` shows"
        )
        raise ConfigError(message) from None
    family, _, _, _, address = min(found, key=lambda entry: entry[0] is not socket.AF_INET)
    return family, str(address[0])


def bind(family: socket.AddressFamily, address: str, port: int, option: str = "--port") -> socket.socket:
    """Return a socket bound to the address; raises ConfigError, which names the option of the port, if not possible."""
    # The protocol is explicit because asyncio turns off Nagle's algorithm, which costs 40 ms per answer, only for TCP.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    # A service that has just stopped must be able to start again.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # Connections inherit it. It bounds what a client leaves unread, and lets the service notice that soon.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
    try:
        listener.bind((address, port))
        listener.listen()
    except OSError as error:
        listener.close()
        message = f"port {port} on {address}: {remedy(error, option)}"
        raise ConfigError(message) from None
    return listener
