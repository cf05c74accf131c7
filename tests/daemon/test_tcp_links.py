"""Frames of Modbus TCP as they come, and why there is no answer, without a network."""

import asyncio
import logging
from collections.abc import Callable

import pytest

from beamtouch_daemon.config.sources import ModbusTcp
from beamtouch_daemon.sources import modbus_tcp, requests
from beamtouch_daemon.sources.host_address import HostAddress, UnknownHostError
from beamtouch_daemon.sources.modbus_tcp import TcpLink
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import Block, RegisterAnswer
from beamtouch_daemon.sources.requests import Failure
from support.network.free_ports import free_port

from .devices import Pieces, RegisterUnit, tcp_unit, with_crc

pytestmark = pytest.mark.anyio

SETTINGS = ModbusTcp(kind="modbus-tcp", host="plc", port=1502, timeout_ms=37.0)
DATA = bytes([4, 4, 0, 7, 1, 8])
"""Function and contents of an answer with two registers."""
NUMBER = 0x0105
BLOCK = Block(0, 2)
"""Of the newest request."""


def link_of(unit: int = 3, host: str = "plc") -> TcpLink:
    link = TcpLink(SETTINGS, host, unit)
    link._transaction = NUMBER
    return link


def frame(data: bytes = DATA, transaction: int = NUMBER, unit: int = 3, protocol: int = 0) -> bytes:
    """Return a frame, as the standard has it: transaction, protocol, number of further bytes, unit, data."""
    return (
        b"".join(number.to_bytes(2, "big") for number in (transaction, protocol, len(data) + 1)) + bytes([unit]) + data
    )


async def received(link: TcpLink, *chunks: bytes) -> bytes:
    """Return what is taken for the answer if these bytes come one after the other, and then nothing."""
    reader = asyncio.StreamReader()

    async def feed() -> None:
        for chunk in chunks:
            reader.feed_data(chunk)
            await asyncio.sleep(0)
            await asyncio.sleep(0)
        reader.feed_eof()

    found, _ = await asyncio.gather(link._receive(reader), feed())
    return found


@pytest.mark.parametrize(
    "chunks",
    [
        [frame()],
        [frame()[:1], frame()[1:5], frame()[5:12], frame()[12:]],
        [frame(unit=0)],
        [frame(unit=255)],  # of the device itself
        [frame(bytes([4, 2, 9, 9]), NUMBER - 1), frame()],  # a late answer before it
        [frame(bytes([4, 2, 9, 9]), NUMBER - 1) + frame()[:9], frame()[9:]],
        [frame(unit=4) + frame(transaction=0) + frame()],
    ],
    ids=["whole", "in pieces", "unit 0", "unit 255", "after a late one", "in one piece with it", "after others"],
)
async def test_the_answer_is_the_frame_with_the_number_of_the_newest_request(chunks: list[bytes]) -> None:
    assert await received(link_of(), *chunks) == DATA


async def test_what_follows_an_answer_is_kept_for_the_next_request() -> None:
    link = link_of()
    assert await received(link, frame() + frame()[:3]) == DATA
    assert link._received == frame()[:3]


WITHIN = "within 37 ms"


@pytest.mark.parametrize(
    ("chunks", "said", "failure"),
    [
        ([], f"unit 3 does not answer {WITHIN}", Failure.SILENT),
        ([frame()[:-1]], f"unit 3 does not answer intact {WITHIN}", Failure.DAMAGED),
        ([frame(protocol=1)], f"unit 3 does not answer intact {WITHIN}", Failure.DAMAGED),
        (
            [frame(transaction=0)],
            "unit 3 answers with transaction number 0, which does not identify the request",
            Failure.FOREIGN,
        ),
        ([frame(transaction=5)], "unit 3 answers with the transaction number of another request", Failure.FOREIGN),
        ([frame(unit=4)], "unit 3 answers as unit 4; state unit = 4 if that is the device", Failure.FOREIGN),
        (
            [with_crc(bytes([3]) + DATA)],
            "plc:1502 is a serial converter: it passes on RTU frames, and unit 3 answers in such frames; write kind = "
            '"modbus-rtu" and port = "tcp://plc:1502" in its source',
            Failure.FOREIGN,
        ),
    ],
    ids=["nothing", "a part", "another protocol", "without a number", "another number", "another unit", "RTU"],
)
async def test_why_no_answer_came_is_said(chunks: list[bytes], said: str, failure: Failure) -> None:
    link = link_of()
    with pytest.raises(EOFError):
        await received(link, *chunks)
    error = link._explain_silence()
    assert (str(error), error.failure) == (said, failure)


def test_a_unit_of_another_device_is_named_with_it() -> None:
    assert [link_of(3).name, link_of(3, "other").name] == ["unit 3", "other unit 3"]
    assert link_of().rest_s == 0.5


async def test_a_device_that_never_answered_is_asked_in_rtu_frames_once_a_minute(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s, asked, answers = 500.0, list[float](), True

    async def answers_in_rtu(*arguments: object) -> bool:
        assert [str(one) for one in arguments] == ["plc:1502", "3", str(Block(30, 2)), "0.037"]
        asked.append(now_s)
        return answers

    monkeypatch.setattr(modbus_tcp, "_answers_in_rtu", answers_in_rtu)
    monkeypatch.setattr(modbus_tcp, "uptime_s", lambda: now_s)
    link = link_of()
    found = []
    for at_s, is_answered in ((500.0, True), (559.9, False), (560.0, False), (560.1, True)):
        now_s, answers = at_s, is_answered
        found.append(await link._is_converter(Block(30, 2)))
    assert (asked, found) == ([500.0, 560.0], [True, True, False, False])
    link._has_answered = True
    now_s, answers = 900.0, True
    assert not await link._is_converter(Block(30, 2))
    assert len(asked) == 2


@pytest.mark.parametrize(("took_s", "asked"), [(0.0, 3), (0.3, 1)])
async def test_a_refusal_that_took_longer_than_a_tenth_of_a_second_is_not_followed_by_another_request(
    took_s: float, asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, sent = link_of(), list[Block]()

    async def ask(block: Block) -> RegisterAnswer:
        sent.append(block)
        return RegisterAnswer(exception=6, asked_s=500.0)

    monkeypatch.setattr(link, "ask", ask)
    monkeypatch.setattr(requests, "uptime_s", lambda: 500.0 + took_s)
    assert (await link.read(Block(30, 2))).exception == 6
    assert sent == [Block(30, 2)] * asked
    assert not await link._is_converter(Block(30, 2))  # it has answered


async def test_the_debug_log_has_each_request_and_what_came(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG, "beamtouch_daemon.sources")
    async with tcp_unit(RegisterUnit(2, 0)) as port:
        settings = ModbusTcp(kind="modbus-tcp", host="127.0.0.1", port=port, timeout_ms=30_000.0)
        link = TcpLink(settings, "127.0.0.1", 1)
        async with link.opened():
            assert (await link.ask(Block(0, 2))).registers == [0, 0]
            assert (await link.ask(Block(1, 2))).exception == 2
    asked = "unit 1 asked for registers"
    assert [line.removeprefix(f"127.0.0.1:{port}: ") for line in caplog.messages] == [
        f"{asked} 0 to 1 by function 4 (00 01 00 00 00 06 01 04 00 00 00 02)",
        "13 bytes came (00 01 00 00 00 07 01 04 04 00 00 00 00)",
        f"{asked} 1 to 2 by function 4 (00 02 00 00 00 06 01 04 00 01 00 02)",
        "9 bytes came (00 02 00 00 00 03 01 84 02)",
        "unit 1: exception 2, it has no such register",
    ]


async def test_transaction_numbers_are_1_to_65535() -> None:
    async with tcp_unit(RegisterUnit(2, 0)) as port:
        settings = ModbusTcp(kind="modbus-tcp", host="127.0.0.1", port=port, timeout_ms=30_000.0)
        link, numbers = TcpLink(settings, "127.0.0.1", 1), list[int]()
        async with link.opened():
            for link._transaction in (0, 1, 65_534, 65_535):
                await link.ask(Block(0, 1))
                numbers.append(link._transaction)
    assert numbers == [1, 2, 65_535, 1]


async def failure_at(port: int, block: Block = BLOCK) -> tuple[str, str]:
    """Ask the unit at a port in vain; return what is said, and the kind of failure."""
    settings = ModbusTcp(kind="modbus-tcp", host="127.0.0.1", port=port, timeout_ms=30_000.0)
    link = TcpLink(settings, "127.0.0.1", 1)
    async with link.opened():
        with pytest.raises(NoAnswerError) as raised:
            await link.ask(block)
    return str(raised.value), raised.value.failure


async def test_a_device_that_is_not_there_or_closes_the_connection_is_said() -> None:
    port = free_port()
    said = f"no connection to 127.0.0.1:{port}; is the device on, and is the address right?"
    assert await failure_at(port) == (said, Failure.UNREACHABLE)

    class Closing(asyncio.Protocol):
        def data_received(self, _data: bytes) -> None:
            self.transport.close()

        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            self.transport = transport

    async with await asyncio.get_running_loop().create_server(Closing, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        said = f"127.0.0.1:{port} closes the connection without an answer"
        assert await failure_at(port) == (said, Failure.CLOSED)


async def test_an_answer_of_another_function_is_that_to_another_request() -> None:
    class Other(RegisterUnit):
        def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
            return super().answer(request, lambda data: wrap(data[:1] + bytes([3]) + data[2:]))

    async with tcp_unit(Other(8, 8)) as port:
        assert await failure_at(port) == ("unit 1 answered another request", Failure.FOREIGN)


async def test_a_name_that_does_not_resolve_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    async def resolve(_address: HostAddress, within_s: float) -> str:
        assert within_s == 0.037
        raise UnknownHostError("plc does not resolve")

    monkeypatch.setattr(HostAddress, "resolve", resolve)
    with pytest.raises(NoAnswerError) as raised:
        await link_of().ask(Block(0, 2))
    assert (str(raised.value), raised.value.failure) == ("plc does not resolve", Failure.UNREACHABLE)
