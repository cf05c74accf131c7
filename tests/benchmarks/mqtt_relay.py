"""A relay between a service and its broker, which notes when each contact leaves the service."""

import re
import socket
import threading
from contextlib import suppress
from time import time

_CONTACT = re.compile(rb'"age_ms":([0-9.]+),"sampled_at":"[^"]+","sequence":([0-9]+),')
_LONGEST = 1000
"""No contact is longer."""


class Relay:
    """Listens on a port of its own. A connection ends when either side ends it."""

    def __init__(self, port: int) -> None:
        self._broker = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self.left: list[tuple[int, float]] = []
        """Sequence number of each contact that left the service, and the time [s since 1970]."""
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client = self._listener.accept()[0]
                try:
                    broker = socket.create_connection(("127.0.0.1", self._broker))
                except OSError:
                    client.close()
                    continue
                threading.Thread(target=self._carry, args=(client, broker, True), daemon=True).start()
                threading.Thread(target=self._carry, args=(broker, client, False), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket, outwards: bool) -> None:
        kept = b""
        with suppress(OSError):
            while content := source.recv(1 << 16):
                if outwards:
                    kept = self._note(kept + content, time())
                sink.sendall(content)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _note(self, content: bytes, now_s: float) -> bytes:
        """Note the contacts in what left, and return what may be the beginning of the next one."""
        end = 0
        for found in _CONTACT.finditer(content):
            self.left.append((int(found[2]), now_s))
            end = found.end()
        return content[end:][-_LONGEST:]
