"""Notifications to the service manager, and the socket that it may pass on (sd_notify, sd_listen_fds; systemd 252)."""

import os
import socket
from time import monotonic_ns

from beamtouch_service.config import ConfigError

_FIRST_FD = 3


class ServiceManager:
    """The manager that started this process. Without one, nothing is sent."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        self._is_ready = False
        watchdog_us = os.environ.get("WATCHDOG_USEC", "")
        is_mine = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(watchdog_us) / 1e6 if watchdog_us.isdecimal() and is_mine else None
        """The manager restarts this process after this time without progress [s]; None if it does not watch."""

    def ready(self, status: str) -> None:
        """Report that the start or a reload is complete."""
        self._is_ready = True
        self._send(f"READY=1\nSTATUS={status}")

    def reloading(self) -> None:
        """Report that models are being read again."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Report that the stop has begun."""
        self._send("STOPPING=1")

    def alive(self) -> None:
        """Report progress. The manager does not watch a service that is still starting."""
        if self._is_ready:
            self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if not self._address:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            try:
                sender.sendto(text.encode(), address)
            except OSError:
                return  # a manager that is gone cannot be notified


def activated() -> socket.socket | None:
    """Return the listening socket that the manager passed on, or None; raises ConfigError if it cannot be used."""
    if os.environ.get("LISTEN_PID") != str(os.getpid()):
        return None
    count = os.environ.get("LISTEN_FDS", "0")
    # Children must not inherit these: they would take the socket for theirs.
    for name in ("LISTEN_PID", "LISTEN_FDS", "LISTEN_FDNAMES"):
        os.environ.pop(name, None)
    if count == "0":
        return None
    if count != "1":
        message = (
            f"{count} sockets were passed on; the service takes one: leave a single ListenStream= in the .socket file"
        )
        raise ConfigError(message)
    try:
        listener = socket.socket(fileno=_FIRST_FD)
        is_tcp = listener.family in {socket.AF_INET, socket.AF_INET6} and listener.type == socket.SOCK_STREAM
    except OSError as error:
        message = f"the socket that was passed on cannot be used: {error.strerror}"
        raise ConfigError(message) from None
    if not is_tcp:
        listener.close()
        message = "the socket that was passed on is not TCP; let ListenStream= name an address and a port"
        raise ConfigError(message)
    os.set_inheritable(_FIRST_FD, False)
    return listener
