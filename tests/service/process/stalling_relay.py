"""A relay between a service and its broker, which stops reading from the service in the middle of a turn."""

import fcntl
import select
import socket
import struct
import termios
import threading
from contextlib import suppress

from service.process.mqtt_packets import read_packets

_UNSUBACK = 0xB0
_BEFORE_CONTACTS = 2
"""The service asks for a first UNSUBACK to learn what the broker keeps, and for the next one before contacts."""
_RECEIVE_BYTES = 4096
WAIT_S = 30.0


class StallingRelay:
    """Passes bytes on. Once contacts are due, it reads no more from the first connection until that is reset."""

    def __init__(self, broker_port: int) -> None:
        self._broker_port = broker_port
        self._listener = socket.socket()
        # Connections inherit it: little waits in the relay itself.
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
        self._listener.bind(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.is_reset = False
        """Whether the service reset the connection after the stop, within `WAIT_S`."""
        self.waiting_bytes = 0
        """What the relay itself had of the connection then, unread."""
        self.rest = b""
        """What still came when it was read again."""
        self.is_over = threading.Event()

    def start(self) -> None:
        self._listener.listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _accept(self) -> None:
        is_first = True
        with suppress(OSError):
            while True:
                service, _ = self._listener.accept()
                broker = socket.create_connection(("127.0.0.1", self._broker_port))
                reads = threading.Event()
                reads.set()
                up = self._pass_first_up if is_first else _pass_on
                threading.Thread(target=up, args=(service, broker, reads), daemon=True).start()
                threading.Thread(target=self._pass_down, args=(broker, service, reads, is_first), daemon=True).start()
                is_first = False

    def _pass_first_up(self, service: socket.socket, broker: socket.socket, reads: threading.Event) -> None:
        arrival, reset = select.poll(), select.poll()
        arrival.register(service, select.POLLIN)
        reset.register(service, 0)
        with service, broker:
            while reads.is_set():
                if arrival.poll(10):
                    broker.sendall(service.recv(512))
            self.is_reset = bool(reset.poll(WAIT_S * 1e3))
            self.waiting_bytes = struct.unpack("i", fcntl.ioctl(service, termios.FIONREAD, b"    "))[0]
            with suppress(OSError):
                while arrival.poll(2000) and (part := service.recv(65_536)):
                    self.rest += part
        self.is_over.set()

    def _pass_down(self, broker: socket.socket, service: socket.socket, reads: threading.Event, is_first: bool) -> None:
        with suppress(OSError), broker.makefile("rb") as stream:
            confirmed = 0
            for packet in read_packets(stream):
                confirmed += packet.kind == _UNSUBACK
                if is_first and confirmed == _BEFORE_CONTACTS:
                    # First the stop, so that nothing of the turn passes.
                    reads.clear()
                service.sendall(packet.whole)


def _pass_on(source: socket.socket, target: socket.socket, _reads: threading.Event) -> None:
    with source, target, suppress(OSError):
        while part := source.recv(65_536):
            target.sendall(part)
