"""Limits and rules for heads and trailers of requests that the parser does not enforce. Pure."""

import re
from collections.abc import Iterable, Mapping, Sequence

from beamtouch_service.problems import Kind, Problem

MAX_HEAD_BYTES, MAX_HEADERS = 16 * 1024, 100

_HOST = re.compile(rb"(\[[0-9A-Za-z:.%_~-]+\]|[0-9A-Za-z._~%!$&'()*+,;=-]*)(:[0-9]{0,5})?")
"""A name, an address or nothing, and a port (RFC 9110, 7.2)."""
_HEAD_END = b"\r\n\r\n"
_CHUNK_SIZE = re.compile(rb"[0-9A-Fa-f]+")


class Framing:
    """Cuts arriving bytes into pieces, so that the end of a head is always the end of a piece.

    A request may begin in the middle of a segment. The bytes of its head can be counted only if the parser gets no
    more than that head.
    """

    def __init__(self) -> None:
        self.in_head = True
        """False from the end of a head to the end of its body."""
        self._held_bytes = 0
        """Bytes of the current head, or, in a chunked body, bytes since the last content: chunk sizes and trailers."""
        self._body_bytes: int | None = None
        """Bytes of the body that are still to come; None for a chunked body."""
        self._chunk_bytes = 0
        """Bytes of the current chunk that are still to come, including the line end behind it."""
        self._size_line: bytes | None = b""
        """The part of the current chunk's size line that was read; None in the trailers."""
        self._moved = False
        """Whether the current piece ended a head, had content or ended a request."""

    @property
    def is_between(self) -> bool:
        """Whether no request has begun since the last one ended."""
        return self.in_head and not self._held_bytes

    def cut(self, data: bytes, start: int) -> int:
        """Return the end of the piece that begins at `start`."""
        if not self.in_head and self._body_bytes is not None:
            return min(start + self._body_bytes, len(data))
        if not self.in_head and self._chunk_bytes:
            return min(start + self._chunk_bytes, len(data))
        # A head that begins here ends with the first empty line. The rest of a head, sizes of chunks and trailers go
        # line by line.
        mark = _HEAD_END if self.is_between else b"\n"
        found = data.find(mark, start)
        return len(data) if found < 0 else found + len(mark)

    def is_too_long(self, size: int = 0) -> bool:
        """Return whether the head is too long with `size` more bytes, or the trailers are too long already."""
        return self._held_bytes + (size if self.in_head else 0) > MAX_HEAD_BYTES

    def fed(self, piece: bytes) -> None:
        """Note that the parser has read this piece."""
        if self._chunk_bytes:
            self._chunk_bytes -= len(piece)
        elif not (self.in_head or self._moved or self._size_line is None):
            self._take_size(self._size_line + piece)
        self._held_bytes = 0 if self._moved else self._held_bytes + len(piece)
        self._moved = False

    def _take_size(self, line: bytes) -> None:
        size = _CHUNK_SIZE.match(line)
        if not line.endswith(b"\n") or size is None:
            self._size_line = line
            return
        chunk_bytes = int(size[0], 16)
        self._chunk_bytes, self._size_line = (chunk_bytes + 2, b"") if chunk_bytes else (0, None)

    @property
    def is_in_chunks(self) -> bool:
        """Whether the current body is chunked, so that its length is not known."""
        return not self.in_head and self._body_bytes is None

    def begin_body(self, content_length: bytes | None) -> None:
        """Note that a head is complete. Without a length, its body is chunked or empty."""
        self.in_head, self._moved = False, True
        self._body_bytes = None if content_length is None else int(content_length)
        self._chunk_bytes, self._size_line = 0, b""

    def content(self, size: int) -> None:
        """Note content of the body [bytes]."""
        self._moved = True
        if self._body_bytes is not None:
            self._body_bytes -= size

    def end(self) -> None:
        """Note that a request is complete."""
        self.in_head, self._moved = True, True


def too_long() -> Problem:
    """Return the problem for a head that is too long."""
    words = f"The request line and headers take at most {MAX_HEAD_BYTES} bytes and {MAX_HEADERS} headers."
    return Problem(Kind.HEAD_TOO_LARGE, words)


Fields = Mapping[bytes, Sequence[bytes]]
"""The values of each header, by its name in lower case."""


def fields(headers: Iterable[tuple[bytes, bytes]]) -> dict[bytes, list[bytes]]:
    """Return the values of each header. The names must be in lower case."""
    found: dict[bytes, list[bytes]] = {}
    for name, value in headers:
        found.setdefault(name, []).append(value)
    return found


def refusal(version: str, head: Fields) -> Problem | None:
    """Return the problem of a head that the parser has accepted, or None."""
    if version not in ("1.0", "1.1"):
        return Problem(Kind.BAD_REQUEST, "The service speaks HTTP/1.1 and HTTP/1.0.")
    hosts, codings = head.get(b"host", ()), head.get(b"transfer-encoding")
    if len(hosts) > 1 or (not hosts and version == "1.1"):
        return Problem(Kind.BAD_REQUEST, f"A request needs exactly one Host header; this one has {len(hosts)}.")
    if hosts and not _HOST.fullmatch(hosts[0].strip()):
        return Problem(Kind.BAD_REQUEST, "The Host header must be a name or an address, with or without a port.")
    if codings and version == "1.0":
        return Problem(Kind.BAD_REQUEST, "HTTP/1.0 has no Transfer-Encoding. Send Content-Length.")
    if codings and b",".join(codings).strip().lower() != b"chunked":
        return Problem(Kind.UNKNOWN_CODING, "Send the body unencoded, with Content-Length or in chunks.")
    return None
