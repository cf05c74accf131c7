"""Connections that are read byte by byte."""

import socket


def read_to_end(connection: socket.socket) -> bytes:
    """Return all that comes until the other side closes."""
    connection.settimeout(60)
    found = b""
    try:
        while chunk := connection.recv(65536):
            found += chunk
    except ConnectionResetError:
        pass
    return found
