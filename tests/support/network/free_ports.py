"""Free ports of loopback, for programs that cannot pick one themselves."""

import fcntl
import random
import socket
from contextlib import suppress
from pathlib import Path
from tempfile import gettempdir
from typing import IO

OUTGOING = Path("/proc/sys/net/ipv4/ip_local_port_range")
_kept: list[IO[bytes]] = []
"""Locks of the ports that this process was given, for as long as it lives."""


def free_port() -> int:
    """Return a port that nothing uses: no other test gets it, and no outgoing connection of this machine."""
    folder = Path(gettempdir()) / "beamtouch-ports"
    folder.mkdir(exist_ok=True)
    highest = int(OUTGOING.read_text().split()[0]) if OUTGOING.exists() else 32_000
    while True:
        port = random.randrange(highest // 2, highest)  # noqa: S311 - no secret
        lock = (folder / str(port)).open("ab")
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with socket.create_server(("127.0.0.1", port)):
                _kept.append(lock)
                return port
        lock.close()
