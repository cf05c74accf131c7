"""A relay between a service and its broker, which ends each connection over some of the packets of the service."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from service.process.mqtt_packets import read_packets

_SUBSCRIBE, _PUBLISH = 0x82, 0x30
Ends = Callable[[int, bytes], bool]
"""Whether a packet ends the connection, by its first byte and what follows its length."""


def subscribes(kind: int, _rest: bytes) -> bool:
    """Return whether a packet asks for messages."""
    return kind == _SUBSCRIBE


def publishes_to(part: str) -> Ends:
    """Return whether a packet is a message to a topic, or of a text, with this part."""
    return lambda kind, rest: kind & 0xF0 == _PUBLISH and part.encode() in rest


@contextmanager
def cutting_relay(broker_port: int, ends: Ends = subscribes) -> Iterator[int]:
    """Give the port of a relay to a broker."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=_accept, args=(listener, broker_port, ends), daemon=True).start()
        yield listener.getsockname()[1]


def _accept(listener: socket.socket, broker_port: int, ends: Ends) -> None:
    with suppress(OSError):
        while True:
            service, _ = listener.accept()
            broker = socket.create_connection(("127.0.0.1", broker_port))
            threading.Thread(target=_pass_down, args=(broker, service), daemon=True).start()
            threading.Thread(target=_pass_up, args=(service, broker, ends), daemon=True).start()


def _pass_up(service: socket.socket, broker: socket.socket, ends: Ends) -> None:
    with service, broker, suppress(OSError), service.makefile("rb") as stream:
        for packet in read_packets(stream):
            if ends(packet.kind, packet.rest):
                break
            broker.sendall(packet.whole)
        # The other thread reads from these.
        for line in (service, broker):
            line.shutdown(socket.SHUT_RDWR)


def _pass_down(broker: socket.socket, service: socket.socket) -> None:
    with suppress(OSError):
        while part := broker.recv(65_536):
            service.sendall(part)
