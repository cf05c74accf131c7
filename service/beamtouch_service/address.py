"""An address to listen on. It may come later: a name may not resolve yet, and a port may still be taken."""

import asyncio
import logging
import socket
from collections.abc import Callable
from errno import EACCES
from ipaddress import ip_address

from beamtouch_common.errors import InputError
from beamtouch_common.listening import remedy
from beamtouch_common.log_lines import Repeated

RETRY_S = 1.0
"""Time between two attempts to listen."""
_SEND_BUFFER_BYTES = 128 * 1024
_UNREAD_MS = 10_000
_QUEUE = 1024
"""New connections that the system keeps until they are accepted. Beyond this it does not answer."""

_log = logging.getLogger(__name__)


class Address:
    """The address on which one part of the service listens.

    Parameters
    ----------
    section, host, port
        The section of the configuration, and what it states.
    option
        Where the user states the port, for messages.
    require
        Raises InputError, for a numeric address or a name, if the service lacks what an address requires that others
        than this machine reach. A name may come to stand for such an address while the service runs: then nothing
        listens, until it stands for another one.

    Raises
    ------
    InputError
        This user may not listen there, or `require` says so: only another configuration can help.
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
        """Why nothing can listen there yet; empty as soon as it can."""
        self._host, self._port, self._option, self._require = host, port, option, require
        self._is_forbidden = False
        if (bound := self._open(listen=False)) is not None:
            bound.close()
        elif self._is_forbidden:
            raise InputError(self.missing)
        self._require_if_open()

    @property
    def is_loopback(self) -> bool:
        """True if only this machine reaches it. A name that does not resolve yet may be any address."""
        try:
            # Without the scope that follows a link-local address.
            address = ip_address(self.shown.partition("%")[0])
            return (getattr(address, "ipv4_mapped", None) or address).is_loopback
        except ValueError:
            return False

    async def listen(self, note: Callable[[str], None]) -> socket.socket:
        """Return a socket that listens, as soon as there can be one; `note` gets the reason of each failure.

        Before this call, no connection can wait there: nobody would notice that its samples grow old.
        """
        # In a thread, because a name server may not answer.
        log, bound = Repeated(_log, f"[{self.section}]"), await asyncio.to_thread(self._open)
        while bound is None:
            log.failed(f"{self.missing}; trying again")
            note(self.missing)
            await asyncio.sleep(RETRY_S)
            bound = await asyncio.to_thread(self._open)
        log.over(f"{self.shown} is there")
        self.missing = ""
        note("")
        return bound

    def _require_if_open(self) -> None:
        if not self.is_loopback:
            self._require(self.shown)

    def _open(self, *, listen: bool = True) -> socket.socket | None:
        """Return a socket at the address; None if that is not possible yet, and `missing` says why."""
        try:
            family, self.shown = _resolve(self._host)
        except (OSError, UnicodeError):
            self.missing = (
                f"host {self._host!r} does not resolve; use 127.0.0.1, or an address that `ip address` shows, "
                "or wait for the name server"
            )
            return None
        # The protocol is explicit because asyncio turns off Nagle's algorithm, which costs 40 ms per answer, only for
        # TCP.
        bound = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        try:
            # A service that has just stopped must be able to start again.
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            # Connections inherit it. It bounds what a client leaves unread, and lets the service notice that soon.
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
            # A client that takes nothing for this long is gone; so is one whose machine was switched off.
            bound.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_MS)
            bound.bind((self.shown, self._port))
            if listen:
                self._require_if_open()
                bound.listen(_QUEUE)
        except InputError as error:
            bound.close()
            self.missing = str(error)
            return None
        except OSError as error:
            bound.close()
            self.missing = f"port {self._port} on {self.shown}: {remedy(error, self._option)}"
            self._is_forbidden = error.errno == EACCES
            return None
        return bound


def _resolve(host: str) -> tuple[socket.AddressFamily, str]:
    """Return family and numeric address of a host, preferably IPv4."""
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    family, _, _, _, address = min(found, key=lambda entry: entry[0] is not socket.AF_INET)
    return family, str(address[0])
