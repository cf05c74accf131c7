"""The first two messages of OPC UA, which show that a server is there."""

import socket
import struct

TIMEOUT_S = 30
HELLO = struct.pack("<4s6Ii", b"HELF", 32, 0, 65535, 65535, 0, 0, -1)


def is_open(url: str) -> bool:
    """Return whether an OPC UA server acknowledges a hello at an address."""
    host, port = url.removeprefix("opc.tcp://").rstrip("/").split(":")
    try:
        with socket.create_connection((host, int(port)), timeout=TIMEOUT_S) as line:
            line.sendall(HELLO)
            return line.recv(4) == b"ACKF"
    except OSError:
        return False
