"""Requests byte by byte, over raw sockets."""

import socket

from .conftest import Service


def connected(service: Service, timeout_s: float = 30.0) -> socket.socket:
    """Return a connection to the service."""
    host, _, port = service.url.removeprefix("http://").rpartition(":")
    connection = socket.create_connection((host, int(port)), timeout=timeout_s)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def closes(connection: socket.socket, within_s: float = 60.0) -> bool:
    """Say whether the service closes a connection within this time, without another word."""
    connection.settimeout(within_s)
    try:
        return connection.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionResetError:
        return True


def get(target: str, *headers: str, version: str = "1.1", method: str = "GET") -> bytes:
    """Return a request without a body."""
    return "\r\n".join([f"{method} {target} HTTP/{version}", "Host: x", *headers, "", ""]).encode()


def said(service: Service, words: bytes, answers: int, *, until_closed: bool = False) -> list[tuple[bytes, bytes]]:
    """Send all at once; return head and body of so many answers, and with `until_closed` see that no more come."""
    found: list[tuple[bytes, bytes]] = []
    with connected(service) as connection:
        connection.sendall(words)
        with connection.makefile("rb") as stream:
            for _ in range(answers):
                head = b""
                while (line := stream.readline()) != b"\r\n":
                    assert line, "closed without an answer"
                    head += line
                found.append((head, stream.read(int(fields(head)[b"content-length"]))))
            assert not until_closed or stream.read() == b""
    return found


def fields(head: bytes) -> dict[bytes, bytes]:
    """Return the headers by name in lower case, but for the date."""
    pairs = (line.split(b": ", 1) for line in head.splitlines()[1:])
    return {name.lower(): value for name, value in pairs if name.lower() != b"date"}


def status(head: bytes) -> int:
    """Return the status of an answer."""
    return int(head.split()[1])
