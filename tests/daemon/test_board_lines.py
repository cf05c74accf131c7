"""A line to a board on a clock of the test: what is sent when, what is taken for an answer, and what is said."""

import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import cast

import pytest

from beamtouch_daemon.config.sources import SerialLine
from beamtouch_daemon.sources import board
from beamtouch_daemon.sources.board import BoardLine, BoardSource, Session
from beamtouch_daemon.sources.kept_port import KeptPort
from beamtouch_daemon.sources.reading import Reading as Taken
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.sources.serial_port import SerialPort
from beamtouch_daemon.sources.traffic import Traffic
from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import (
    PROTOCOL_VERSION,
    SCHEMA_HASH,
    Hello,
    HelloRequest,
    Message,
    Ping,
    Pong,
    Reading,
    Start,
    Stop,
)

pytestmark = pytest.mark.anyio

OPENED_S = 1000.0
HELLO = Hello(PROTOCOL_VERSION, SCHEMA_HASH, 7, 3, 10, 2000)
SILENT = "the port is open, but not a byte came; check supply and wiring"


class Port(SerialPort):
    """An open port at a time that goes on as it is waited for, with a device at its other end."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.path = "/dev/x"
        self.now_s = self.taken_s = OPENED_S
        self.traffic = Traffic(OPENED_S)
        self.sent: list[tuple[float, Message]] = []
        """What was sent, each with the time since the port was opened."""
        self.coming: list[tuple[float, bytes]] = []
        self.device: Callable[[Message], list[tuple[float, Message]]] = lambda _: []
        """Returns what the device answers, each after so many seconds."""
        monkeypatch.setattr(board, "uptime_s", lambda: self.now_s)

    @asynccontextmanager
    async def used(self) -> AsyncIterator["Port"]:
        yield self

    def send(self, data: bytes) -> None:
        for message in Decoder().feed(data):
            self.sent.append((round(self.now_s - OPENED_S, 6), message))
            self.coming += [(self.now_s + after_s, encode(one)) for after_s, one in self.device(message)]
        self.coming.sort(key=lambda row: row[0])

    async def receive(self, within_s: float) -> bytes:
        end_s = self.now_s + within_s
        if not self.coming or self.coming[0][0] > end_s:
            self.now_s = self.taken_s = end_s
            return b""
        self.now_s = self.taken_s = max(self.now_s, self.coming[0][0])
        arrived = [data for at_s, data in self.coming if at_s <= self.now_s]
        del self.coming[: len(arrived)]
        return b"".join(arrived)


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> Port:
    return Port(monkeypatch)


def line_of(port: Port) -> BoardLine:
    return BoardLine(port)


@pytest.mark.parametrize(
    ("has_booted", "asked_s", "until_s"),
    [(False, [0.0, 0.3, 0.9, 2.1, 4.5, 6.9], 8.0), (True, [0.0, 0.3, 0.9, 2.1], 3.0)],
    ids=["it may boot", "it has booted"],
)
async def test_a_hello_is_asked_for_ever_more_rarely_for_3_s_or_as_long_as_a_device_may_boot(
    port: Port, *, has_booted: bool, asked_s: list[float], until_s: float
) -> None:
    if has_booted:
        port.traffic.note_frame(OPENED_S - 60.0)
    with pytest.raises(SourceError) as raised:
        await line_of(port).introduce()
    assert raised.value.reason == "/dev/x: no hello of a Beamtouch board"
    assert raised.value.observed == SILENT.replace(";", " since its last frame;" if has_booted else ";")
    assert port.sent == [(at_s, message) for at_s in asked_s for message in (Stop(), HelloRequest())]
    assert port.now_s == pytest.approx(OPENED_S + until_s)


async def test_of_several_hellos_the_newest_counts(port: Port) -> None:
    newer = Hello(PROTOCOL_VERSION, SCHEMA_HASH, 8, 3, 10, 2000)
    reading = Reading(1, 5, 1, (1, 2, 3))
    port.coming = [(OPENED_S + 0.2, encode(HELLO) + encode(newer) + encode(reading))]
    assert await line_of(port).introduce() == newer
    assert port.traffic.boots_until_s < 0  # what sends frames has booted


async def test_bytes_that_are_no_message_are_told_and_an_echo_is_not(port: Port) -> None:
    line = line_of(port)
    port.coming = [(OPENED_S, encode(Ping(7)))]
    (echo,) = await line.receive(0.1)
    assert (echo.message, echo.monotonic_s, port.traffic.noise) == (Ping(7), OPENED_S, "")
    assert port.traffic.boots_until_s > 0
    port.coming = [(OPENED_S + 3.0, b"\1\2\3\0")]
    assert await line.receive(5.0) == []
    assert line.observed == "the port is open, and 4 bytes came, none of them a frame; check baud and parity"
    port.coming = [(OPENED_S + 4.0, encode(Pong(7, 5)))]
    (pong,) = await line.receive(5.0)
    assert (pong.message, pong.monotonic_s) == (Pong(7, 5), OPENED_S + 4.0)
    assert (line.observed, port.traffic.describe_last_frame(OPENED_S + 5.0)) == (
        "",
        "the last intact frame came 1.0 s ago",
    )


async def test_the_debug_log_has_what_is_sent_and_what_comes(port: Port, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    line = line_of(port)
    line.send(Ping(7))
    for data in (encode(Pong(7, 5)), b"boot 1", b"\1\2", b""):
        port.coming = [(OPENED_S, data)]
        await line.receive(0.1)
    assert caplog.messages == [
        f"/dev/x: sent {Ping(7)}",
        f"/dev/x: received {Pong(7, 5)}",
        "/dev/x: 6 bytes came (62 6f 6f 74 20 31): text: 'boot 1'",
        "/dev/x: 2 bytes came (01 02): no whole message, or one with a wrong checksum",
    ]
    caplog.set_level(logging.INFO)
    await line.receive(0.1)
    assert len(caplog.messages) == 4


def source(port: Port, rate_hz: float = 200.0) -> BoardSource:
    settings = SerialLine(kind="serial", port="/dev/x", oversampling=64)
    made = BoardSource(settings, (0, 2), rate_hz, (10, 10))
    made._port = cast(KeptPort, port)
    return made


async def test_a_board_whose_clock_stays_unknown_is_pinged_for_3_s(port: Port) -> None:
    with pytest.raises(SourceError) as raised:
        await source(port)._meet(line_of(port), Session(HELLO, (0, 2)))
    assert raised.value.reason == "/dev/x: no answer to a ping within 3 s, so the age of its readings is unknown"
    assert raised.value.observed == SILENT
    assert [at_s for at_s, _ in port.sent[:10]] == pytest.approx([0.3 * number for number in range(10)])
    assert port.now_s == pytest.approx(OPENED_S + 3.0)


async def test_a_session_asks_checks_pings_starts_and_ends_in_silence_with_a_stop(port: Port) -> None:
    def device(message: Message) -> list[tuple[float, Message]]:
        match message:
            case HelloRequest():
                return [(0.01, HELLO)]
            case Ping(token):
                return [(0.01, Pong(token, round((port.now_s - OPENED_S + 0.005) * 1e6)))]
            case Start():
                begun_us = round((port.now_s - OPENED_S) * 1e6)
                frames = [Reading(5 + at, begun_us + 5000 * at, 64, (640, 0, 1280)) for at in range(1, 201)]
                return [(0.005 * at, frame) for at, frame in enumerate(frames, 1)]
        return []

    port.device = device
    taken = list[Taken]()

    async def read() -> None:
        async for readings in source(port).readings():
            taken.extend(readings)

    with pytest.raises(SourceError) as raised:
        await read()
    assert [reading.counts for reading in taken] == [(10.0, 20.0)] * 200
    assert [reading.lost for reading in taken] == [0] * 200
    assert raised.value.reason == "/dev/x: no reading for 0.5 s (200 Hz, oversampling 64)"
    sent = [message for _, message in port.sent]
    assert sent[:2] == [Stop(), HelloRequest()]
    assert sent[3] == Start(200, 64)
    assert sent[-1] == Stop()
    assert {type(message) for message in (sent[2], *sent[4:-1])} == {Ping}
    # The last reading comes a second after the start; pongs are no readings.
    started_s = port.sent[3][0]
    assert started_s + 1.5 <= port.sent[-1][0] < started_s + 2.0
