"""The listening socket that systemd may pass on (sd_listen_fds; systemd 252).

Notifications to systemd are in `beamtouch_common.systemd`.
"""

import os
import socket

from beamtouch_service.config import ConfigError

_FIRST_FD = 3


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
