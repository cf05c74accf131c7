"""A relay between a service and its broker, which ends each connection that subscribes to anything."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_SUBSCRIBE = 0x82


@contextmanager
def cutting_relay(broker_port: int) -> Iterator[int]:
    """Give the port of a relay to a broker."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=_accept, args=(listener, broker_port), daemon=True).start()
        yield listener.getsockname()[1]


def _accept(listener: socket.socket, broker_port: int) -> None:
    with suppress(OSError):
        while True:
            service, _ = listener.accept()
            broker = socket.create_connection(("127.0.0.1", broker_port))
            threading.Thread(target=_pass_down, args=(broker, service), daemon=True).start()
            threading.Thread(target=_pass_up, args=(service, broker), daemon=True).start()


def _pass_up(service: socket.socket, broker: socket.socket) -> None:
    with service, broker, suppress(OSError), service.makefile("rb") as packets:
        while (head := packets.read(1)) and head[0] != _SUBSCRIBE:
            size = packets.read(1)
            while size[-1] & 0x80:
                size += packets.read(1)
            length = sum((byte & 0x7F) << 7 * place for place, byte in enumerate(size))
            broker.sendall(head + size + packets.read(length))
        # The other thread reads from these.
        for line in (service, broker):
            line.shutdown(socket.SHUT_RDWR)


def _pass_down(broker: socket.socket, service: socket.socket) -> None:
    with suppress(OSError):
        while part := broker.recv(65_536):
            service.sendall(part)
