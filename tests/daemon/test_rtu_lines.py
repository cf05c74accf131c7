"""A Modbus RTU line on a clock of the test: what is sent when, which bytes answer, and what is said of the others."""

import asyncio
import logging
import math

import pytest

from beamtouch_daemon.sources import rtu_line
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import Block, RegisterAnswer
from beamtouch_daemon.sources.requests import Failure
from beamtouch_daemon.sources.rtu_frames import encode
from beamtouch_daemon.sources.rtu_line import RtuLine, UnitLine
from beamtouch_daemon.sources.serial_port import SerialPort
from beamtouch_daemon.sources.traffic import Traffic

from .devices import with_crc

pytestmark = pytest.mark.anyio

OPENED_S = 1000.0
SILENCE_S, TIMEOUT_S = 0.25, 0.0625
BLOCK = Block(30, 2)
REQUEST = encode(3, BLOCK)
ANSWER, LONGER, REFUSAL = (
    with_crc(bytes(frame)) for frame in ([3, 4, 4, 0, 7, 1, 8], [3, 4, 6, 0, 7, 0, 8, 0, 9], [3, 0x84, 2])
)
OTHER = with_crc(bytes([5, 4, 2, 0, 7]))


class Port(SerialPort):
    """An open port at a time that goes on as it is waited for; `coming` are bytes with the time of their arrival."""

    def __init__(self) -> None:
        self.path = "/dev/x"
        self.now_s = self.taken_s = OPENED_S
        self.traffic = Traffic(OPENED_S)
        self.sent: list[tuple[float, bytes]] = []
        self.coming: list[tuple[float, bytes]] = []
        self.answers: list[list[tuple[float, bytes]]] = []
        """What comes after each request, so many seconds later."""

    def send(self, data: bytes) -> None:
        self.sent.append((self.now_s - OPENED_S, data))
        after = self.answers.pop(0) if self.answers else []
        self.coming = sorted(self.coming + [(self.now_s + after_s, piece) for after_s, piece in after])

    async def receive(self, within_s: float) -> bytes:
        begin_s, end_s = self.now_s, self.now_s + within_s
        self.now_s = min(max(self.coming[0][0], begin_s), end_s) if self.coming else end_s
        return self.take()

    def take(self) -> bytes:
        arrived = [data for at_s, data in self.coming if at_s <= self.now_s]
        del self.coming[: len(arrived)]
        self.taken_s = self.now_s
        return b"".join(arrived)


class Bench:
    """A line with its port, and what came through it unexpectedly."""

    def __init__(self) -> None:
        self.port = Port()
        self.unexpected = list[bytes]()
        self.line = RtuLine(self.port, SILENCE_S, self.unexpected.append)

    @property
    def last_frame(self) -> str:
        return self.port.traffic.describe_last_frame(self.port.now_s)

    def at(self, since_s: float) -> None:
        self.port.now_s = OPENED_S + since_s

    async def ask(self, *pieces: tuple[float, bytes], block: Block = BLOCK) -> RegisterAnswer:
        """Ask unit 3 for a block; these bytes come after the request, so many seconds later."""
        self.port.answers = [list(pieces)]
        return await self.line.exchange(3, block, TIMEOUT_S)

    async def fail(self, *pieces: tuple[float, bytes]) -> tuple[str, str]:
        """Ask unit 3 in vain; return what is said, and the kind of failure."""
        with pytest.raises(NoAnswerError) as raised:
            await self.ask(*pieces)
        return str(raised.value), raised.value.failure


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    made = Bench()

    async def sleep(pause_s: float) -> None:
        made.port.now_s += pause_s

    monkeypatch.setattr(rtu_line, "uptime_s", lambda: made.port.now_s)
    monkeypatch.setattr(asyncio, "sleep", sleep)
    return made


SILENT = ("unit 3 does not answer within 62 ms", Failure.SILENT)
LATE = ("unit 3 answers, but not within 62 ms: its answers come late", Failure.LATE)
DAMAGED = ("unit 3 does not answer intact within 62 ms", Failure.DAMAGED)


async def test_an_answer_may_come_in_pieces_and_the_next_request_follows_a_silence(bench: Bench) -> None:
    answer = await bench.ask((0.01, ANSWER[:4]), (0.02, ANSWER[4:]))
    assert (answer.registers, answer.asked_s) == ([7, 264], OPENED_S)
    assert bench.port.now_s == pytest.approx(OPENED_S + 0.02)
    assert bench.last_frame == "the last intact frame came 0.0 s ago"
    assert (await bench.ask((0.0, ANSWER))).asked_s == pytest.approx(OPENED_S + 0.02 + SILENCE_S)
    assert [data for _, data in bench.port.sent] == [REQUEST, REQUEST]
    assert [at_s for at_s, _ in bench.port.sent] == pytest.approx([0.0, 0.02 + SILENCE_S])
    bench.at(50.0)
    await bench.ask((0.0, ANSWER))
    assert bench.port.sent[-1][0] == 50.0  # a line that was silent is free


async def test_an_echo_is_no_answer_and_what_comes_beside_one_is_passed_on(bench: Bench) -> None:
    refused = await bench.ask((0.01, REQUEST + OTHER), (0.02, REFUSAL + b"\1\2"))
    assert (refused.registers, refused.exception) == ((), 2)
    assert bench.unexpected == [b"", OTHER, b"\1\2"]


async def test_a_unit_line_asks_its_unit_with_its_timeout(bench: Bench) -> None:
    unit = UnitLine(bench.line, 3, 0.5)
    bench.port.answers = [[(0.4, ANSWER)]]
    assert (await unit.ask(BLOCK)).registers == [7, 264]
    began_s = bench.port.now_s
    assert await unit.is_quiet()
    assert bench.port.now_s == pytest.approx(began_s + 0.5)  # with the silence between frames


@pytest.mark.parametrize(
    ("pieces", "said"),
    [
        ([], SILENT),
        ([(0.01, REQUEST)], SILENT),
        ([(0.01, b"\1")], DAMAGED),
        ([(0.01, ANSWER[:-1])], DAMAGED),
        ([(0.01, OTHER)], DAMAGED),
        ([(0.01, LONGER)], LATE),  # an answer to another request
        ([(0.0626, ANSWER)], SILENT),
    ],
    ids=["nothing", "an echo", "a byte", "a part", "another unit", "another length", "too late"],
)
async def test_an_answer_that_does_not_come_in_time_is_said_by_what_came(
    bench: Bench, pieces: list[tuple[float, bytes]], said: tuple[str, str]
) -> None:
    assert await bench.fail(*pieces) == said
    assert bench.port.now_s == pytest.approx(OPENED_S + TIMEOUT_S)


async def test_a_unit_whose_answer_came_after_the_timeout_is_late_for_10_s_if_it_then_says_nothing(
    bench: Bench,
) -> None:
    assert await bench.fail((0.1, ANSWER)) == SILENT
    assert await bench.fail() == LATE  # the answer came before this request, and was seen at its begin
    seen_s = bench.port.sent[-1][0]
    assert await bench.fail((0.01, b"\1")) == DAMAGED
    bench.at(seen_s + 10.0 - TIMEOUT_S - 0.01)
    assert await bench.fail() == LATE
    bench.at(seen_s + 10.0 - TIMEOUT_S)
    assert await bench.fail() == SILENT


async def test_a_unit_that_answers_in_time_again_is_no_longer_late(bench: Bench) -> None:
    await bench.fail((0.1, ANSWER))
    await bench.ask((0.01, ANSWER))
    assert await bench.fail() == SILENT


async def test_a_copy_of_an_answer_that_came_in_time_makes_no_unit_late(bench: Bench) -> None:
    await bench.ask((0.01, ANSWER), (0.05, ANSWER))
    assert await bench.fail() == SILENT
    assert bench.unexpected == [b"", b"", b"", ANSWER]


@pytest.mark.parametrize(("beyond", "is_frame"), [(4096 - len(OTHER), True), (4096 - len(OTHER) + 1, False)])
async def test_frames_that_nobody_waits_for_are_sought_among_the_newest_4096_bytes(
    bench: Bench, beyond: int, *, is_frame: bool
) -> None:
    bench.port.coming = [(OPENED_S, OTHER + b"\xff" * beyond)]
    await bench.ask((0.01, ANSWER))
    assert [len(data) for data in bench.unexpected] == [4096, 0, 0]
    bench.at(7.0)
    bench.port.coming = [(OPENED_S, OTHER + b"\xff" * beyond)]
    await bench.fail()
    assert bench.last_frame == f"the last intact frame came {TIMEOUT_S if is_frame else 7.0525:.1f} s ago"


@pytest.mark.parametrize(("timeout_s", "listens_s"), [(0.05, 0.1), (0.3, 0.3), (0.9, 0.5)])
async def test_a_start_listens_for_a_timeout_and_for_a_tenth_to_half_a_second(
    bench: Bench, timeout_s: float, listens_s: float
) -> None:
    assert await bench.line.is_quiet(3, timeout_s)
    assert bench.port.now_s == pytest.approx(OPENED_S + listens_s)


@pytest.mark.parametrize(
    ("at_s", "data", "is_quiet"),
    [
        (0.0, ANSWER, False),
        (0.25, ANSWER, False),
        (0.3, ANSWER, False),
        (0.31, ANSWER, True),
        (0.1, bytes([9, 3, 3, 9]), False),  # the begin of an answer
        (0.1, bytes([9, 3, 0x82, 9]), False),
        (0.1, bytes([9, 3, 5, 9]), True),  # no function that reads
        (0.1, OTHER, True),
    ],
)
async def test_a_line_is_quiet_if_no_answer_of_the_unit_begins(
    bench: Bench, at_s: float, data: bytes, *, is_quiet: bool
) -> None:
    bench.port.coming = [(OPENED_S + at_s, data)]
    assert await bench.line.is_quiet(3, 0.3) == is_quiet


async def test_bytes_that_are_no_frames_are_counted(bench: Bench) -> None:
    assert math.isinf(bench.port.traffic.boots_until_s) is False
    await bench.fail((0.01, b"\1\2\3"))
    assert bench.port.traffic.noise == "3 bytes"
    await bench.fail((0.01, OTHER))
    assert bench.port.traffic.noise == ""


ASKED = f"/dev/x: unit 3 asked for registers 30 to 31 by function 4 ({REQUEST.hex(' ')})"


@pytest.fixture
def debug(caplog: pytest.LogCaptureFixture) -> pytest.LogCaptureFixture:
    caplog.set_level(logging.DEBUG, "beamtouch_daemon.sources")
    return caplog


async def test_the_debug_log_has_each_answer_and_what_came_beside_it(
    bench: Bench, debug: pytest.LogCaptureFixture
) -> None:
    await bench.ask((0.0315, ANSWER))
    await bench.ask((0.0, REQUEST), (0.0315, ANSWER))
    await bench.ask((0.0315, REFUSAL + b"\xfe"))
    stray = "stray bytes, harmless while answers come intact: noise, no bias or termination, or a transmitter"
    first, echoed, refused = debug.messages
    assert first == f"{ASKED}; answered after 31.5 ms ({ANSWER.hex(' ')})"
    both = (REQUEST + ANSWER).hex(" ")
    assert echoed == f"{ASKED}; answered after 31.5 ms ({both}); the adapter echoes requests"
    came = (REFUSAL + b"\xfe").hex(" ")
    assert refused.startswith(
        f"{ASKED}; answered after 31.5 ms ({came}); exception 2, it has no such register; 1 byte came after it (fe): "
        f"{stray}"
    )


async def test_the_debug_log_has_each_missing_answer_with_what_came_and_what_to_check(
    bench: Bench, debug: pytest.LogCaptureFixture
) -> None:
    await bench.fail()
    await bench.fail((0.01, b"\1\2\3"))
    await bench.ask((0.01, ANSWER))
    await bench.fail()
    none, bytes_came, _, again = debug.messages
    silent = f"{ASKED}; no answer within 62 ms: not a byte came; "
    never = "no intact frame has come since the port was opened"
    assert none == (
        f"{silent}{never}; silence has many reasons: with the daemon stopped, `beamtouch-daemon scan /dev/x` finds "
        "baud, parity and number; if it finds no unit, exchange A and B, then check the supply"
    )
    assert bytes_came.startswith(f"{ASKED}; no answer within 62 ms: 3 bytes came (01 02 03): no Modbus frame: ")
    assert bytes_came.endswith(f"; {never}")
    assert again == (
        f"{silent}the last intact frame came 0.3 s ago; unit 3 has answered before: check its supply and its cable, or "
        "raise timeout_ms"
    )


async def test_the_debug_log_has_what_came_between_two_requests(bench: Bench, debug: pytest.LogCaptureFixture) -> None:
    await bench.fail((0.1, ANSWER))
    await bench.ask((0.01, ANSWER))
    _, between, _ = debug.messages
    assert between == (
        f"/dev/x: before a request {len(ANSWER)} bytes came ({ANSWER.hex(' ')}): the late answer of unit 3 to the "
        "request before, read 312 ms after it: raise timeout_ms"
    )


async def test_a_silent_unit_beside_one_that_answered_has_another_number_or_no_supply(
    bench: Bench, debug: pytest.LogCaptureFixture
) -> None:
    await bench.fail((0.01, OTHER))
    await bench.fail()
    assert debug.messages[-1].endswith(
        "; other units answer, so the line works: check the number of unit 3, its supply and its cable"
    )
