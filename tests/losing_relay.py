"""A relay to PostgreSQL that can lose an answer: the database has carried out a transaction, and nobody hears of it."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread


class LosingRelay:
    """Passes bytes on between clients and a server of loopback."""

    def __init__(self, port: int) -> None:
        self._server_port = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.lose = Event()
        """Whether to end the next connection that commits, once the database has done so."""
        Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Take no more connections."""
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self._server_port))
            losing = Event()
            Thread(target=self._requests, args=(client, server, losing), daemon=True).start()
            Thread(target=self._answers, args=(client, server, losing), daemon=True).start()

    def _requests(self, client: socket.socket, server: socket.socket, losing: Event) -> None:
        while words := _received(client):
            if b"COMMIT" in words and self.lose.is_set():
                self.lose.clear()
                losing.set()
            with suppress(OSError):  # the other thread sees its end
                server.sendall(words)
        _end(client, server)

    def _answers(self, client: socket.socket, server: socket.socket, losing: Event) -> None:
        while (words := _received(server)) and not losing.is_set():
            with suppress(OSError):
                client.sendall(words)
        _end(client, server)


def _received(line: socket.socket) -> bytes:
    try:
        return line.recv(65_536)
    except OSError:
        return b""


def _end(*lines: socket.socket) -> None:
    for one in lines:
        with suppress(OSError):
            one.shutdown(socket.SHUT_RDWR)
        one.close()


@contextmanager
def relay_to(port: int) -> Iterator[LosingRelay]:
    """Give a relay to a port of loopback."""
    relay = LosingRelay(port)
    yield relay
    relay.close()
