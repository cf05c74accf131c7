"""A service with a Modbus TCP server, and requests to it byte by byte."""

import re
import socket
import struct
from dataclasses import dataclass

from .conftest import Service, StartService

ADDRESS = re.compile(r"Modbus TCP server: listening on 127\.0\.0\.1:(\d+)")


@dataclass(frozen=True)
class ModbusService:
    """A service whose surfaces are press-7, with a model, and bare, without one."""

    http: Service
    port: int

    def connected(self, timeout_s: float = 60.0, receive_bytes: int = 0) -> socket.socket:
        """Return a connection to the Modbus TCP server."""
        connection = socket.socket()
        if receive_bytes:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
        connection.settimeout(timeout_s)
        connection.connect(("127.0.0.1", self.port))
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection

    def registers(self, address: int = 0, count: int = 40) -> list[int]:
        """Return registers, over a connection of their own."""
        with self.connected() as connection:
            return ask(connection, address, count)


def start_modbus(start_press: StartService, options: str) -> ModbusService:
    """Start a service with these lines in its section [modbus_server]."""
    service = start_press(sections=f"[surfaces.bare]\n[modbus_server]\nport = 0\n{options}\n")
    assert service.process.stderr is not None
    for line in service.process.stderr:
        if found := ADDRESS.search(line):
            return ModbusService(service, int(found[1]))
    raise AssertionError(service.process.communicate()[1])


def frame(body: bytes, transaction: int, unit: int = 1) -> bytes:
    """Return function and data as a frame."""
    return struct.pack(">HHHB", transaction, 0, 1 + len(body), unit) + body


def request(address: int, count: int, transaction: int = 1) -> bytes:
    """Return a request for registers."""
    return frame(struct.pack(">BHH", 4, address, count), transaction)


def answered(connection: socket.socket) -> bytes:
    """Return the next answer, from its transaction to its last byte; empty after the end of the connection."""
    found = b""
    while len(found) < 6 or len(found) < 6 + int.from_bytes(found[4:6]):
        wanted = 6 + int.from_bytes(found[4:6]) if len(found) >= 6 else 6
        received = connection.recv(wanted - len(found))
        if not received:
            return b""
        found += received
    return found


def ask(connection: socket.socket, address: int = 0, count: int = 40) -> list[int]:
    """Return registers."""
    connection.sendall(request(address, count))
    answer = answered(connection)
    assert answer[7] == 4, answer
    return list(struct.unpack(f">{count}H", answer[9:]))
