"""A broker of MQTT 5 in a thread: it answers the requests of one connection as it is told, and notes them."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from typing import Self

from service.process.mqtt_packets import Packet, read_packets

CONNECT, PUBLISH, SUBSCRIBE, UNSUBSCRIBE = 1, 3, 8, 10


class SmallBroker:
    """Takes one connection. `reasons`: kind of request -> the reason that it answers; None for no answer at all."""

    def __init__(self, reasons: dict[int, int | None] | None = None, *, ends_at: int = 0, sends: bytes = b"") -> None:
        """`ends_at`: kind of request at which it ends the connection; `sends`: behind its answer to a subscription."""
        self.packets: list[Packet] = []
        self._reasons, self._ends_at, self._sends = reasons or {}, ends_at, sends
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(60)

    def of(self, kind: int) -> list[Packet]:
        return [one for one in self.packets if one.kind >> 4 == kind]

    def _run(self) -> None:
        with suppress(OSError):
            sock, _ = self._listener.accept()
            with sock, sock.makefile("rb") as stream:
                for packet in read_packets(stream):
                    self.packets.append(packet)
                    if packet.kind >> 4 == self._ends_at:
                        return
                    sock.sendall(self._answer(packet))

    def _answer(self, packet: Packet) -> bytes:
        kind, rest = packet.kind >> 4, packet.rest
        reason = self._reasons.get(kind, 0)
        if reason is None:
            return b""
        if kind == CONNECT:
            return bytes([0x20, 3, 0, reason, 0])
        if kind == PUBLISH and packet.kind & 0b110:
            at = 2 + int.from_bytes(rest[:2])
            return bytes([0x40, 4, *rest[at : at + 2], reason, 0])
        if kind == SUBSCRIBE:
            return bytes([0x90, 4, *rest[:2], 0, reason]) + self._sends
        return bytes([0xB0, 4, *rest[:2], 0, reason]) if kind == UNSUBSCRIBE else b""
