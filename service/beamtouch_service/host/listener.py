"""An address to listen on. It may come later: a name may not resolve yet, and a port may still be taken."""

import asyncio
import logging
import socket
import time
from collections.abc import Callable
from errno import EACCES

from beamtouch_common.listening import remedy
from beamtouch_service.config import ConfigError
from beamtouch_service.limits import Seldom

RETRY_S = 1.0
"""Time between two attempts to listen."""
_SEND_BUFFER_BYTES = 128 * 1024
_UNREAD_MS = 10_000
_QUEUE = 1024
"""New connections that the system keeps until they are accepted. Beyond this it does not answer."""

_log = logging.getLogger("beamtouch.service")


class Address:
    """Where one part of the service listens.

    Parameters
    ----------
    section, host, port
        The section of the configuration, and what it states.
    option
        Where the user states the port, for messages.
    require
        Raises ConfigError if the service must not listen on an address, or on a name that does not resolve yet.

    Raises
    ------
    ConfigError
        Only another configuration can help.
    """

    def __init__(
        self,
        section: str,
        host: str,
        port: int,
        option: str = "--port",
        require: Callable[[str], None] = lambda _address: None,
    ) -> None:
        self.section = section
        self.shown = host
        """The numeric address; the name as long as it does not resolve."""
        self.missing = ""
        """Why nothing listens there yet; empty as soon as something does."""
        self._host, self._port, self._option, self._require = host, port, option, require
        self._bound: socket.socket | None = None
        self._attempt()

    async def listener(self, note: Callable[[str], None]) -> socket.socket:
        """Return a socket that listens, at once or as soon as there is one; `note` gets the reason of each failure."""
        seldom, begin_s = Seldom(), time.monotonic()
        while (listener := self._listening()) is None:
            if seldom.due(self.missing, time.monotonic()):
                _log.warning("[%s]: %s; trying again", self.section, self.missing)
            note(self.missing)
            await asyncio.sleep(RETRY_S)
            try:
                await asyncio.to_thread(self._attempt)
            except ConfigError as error:
                self.missing = str(error)
        if self.missing:
            _log.info("[%s]: %s is there after %.1f s", self.section, self.shown, time.monotonic() - begin_s)
        self.missing = ""
        note("")
        return listener

    def close(self) -> None:
        """Close the socket, if there is one."""
        if self._bound is not None:
            self._bound.close()

    def _listening(self) -> socket.socket | None:
        """Begin to listen: only now, so that nothing waits before the service takes it."""
        if self._bound is not None:
            try:
                self._bound.listen(_QUEUE)
            except OSError as error:  # another program was quicker
                self._refused(error)
                self._bound.close()
                self._bound = None
        return self._bound

    def _attempt(self) -> None:
        try:
            family, self.shown = _resolve(self._host)
        except (OSError, UnicodeError):
            self._require(self._host)
            self.missing = (
                f"host {self._host!r} does not resolve; use 127.0.0.1, or an address that `ip address` shows, "
                "or wait for the name server"
            )
            return
        self._require(self.shown)
        try:
            self._bound = _bind(family, self.shown, self._port)
        except OSError as error:
            self._refused(error)
            if error.errno == EACCES:
                raise ConfigError(self.missing) from None

    def _refused(self, error: OSError) -> None:
        self.missing = f"port {self._port} on {self.shown}: {remedy(error, self._option)}"


def _resolve(host: str) -> tuple[socket.AddressFamily, str]:
    """Return family and numeric address of a host, preferably IPv4."""
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    family, _, _, _, address = min(found, key=lambda entry: entry[0] is not socket.AF_INET)
    return family, str(address[0])


def _bind(family: socket.AddressFamily, address: str, port: int) -> socket.socket:
    """Return a socket that is bound to an address."""
    # The protocol is explicit because asyncio turns off Nagle's algorithm, which costs 40 ms per answer, only for TCP.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        # A service that has just stopped must be able to start again.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # Connections inherit it. It bounds what a client leaves unread, and lets the service notice that soon.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        # A client that takes nothing for this long is gone; so is one whose machine was switched off.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_MS)
        listener.bind((address, port))
    except OSError:
        listener.close()
        raise
    return listener
