"""An open port as a Modbus RTU line: requests of one master, one at a time, and the answers to them."""

import asyncio
import logging
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources.frame_diagnosis import (
    Request,
    describe_beside,
    describe_received,
    describe_request,
    describe_silence,
    holds_answer,
    in_hex,
)
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import Block, RegisterAnswer, answer_to
from beamtouch_daemon.sources.requests import Failure, exception_words, insist
from beamtouch_daemon.sources.rtu_frames import (
    ENVELOPE_BYTES,
    MAX_FRAME_BYTES,
    READ_FUNCTIONS,
    answers_of,
    encode,
    senders_of,
)
from beamtouch_daemon.sources.serial_port import SerialPort

QUIET_S = (0.1, 0.5)
"""Bounds of the silence that a proof needs at the start of a session; in between, it is one timeout."""
RECENT_BYTES = 4096
"""Frames that nobody waits for are looked for among so many of the newest bytes, more than a line carries in a tenth of
a second. A line that babbles, or a converter that had stored much, must not hold up other surfaces."""
LATE_S = 10.0
"""A unit whose answer came late, and that then sends nothing, is said to be late for so long."""
_logger = logging.getLogger(__name__)


class RtuLine:
    """An open port that carries requests and answers, one pair at a time.

    Parameters
    ----------
    port : The open port.
    silence_s : Silence between two frames [s].
    take_unexpected : Is given bytes that were no answer to the request on the line.
    """

    def __init__(
        self, port: SerialPort, silence_s: float, take_unexpected: Callable[[bytes], None] = lambda _: None
    ) -> None:
        self.port = port
        self._silence_s = silence_s
        self._take_unexpected = take_unexpected
        self._lock = asyncio.Lock()
        """Held for one request and its answer."""
        self._free_s = 0.0
        self._earlier: Request | None = None
        """The last request that is over; None if it was answered, unless the debug log is to tell a second answer."""
        self._answering = set[int]()
        """Units that have answered, for the debug log."""
        self._late_s = dict[int, float]()
        """Time of the last answer of a unit that came after its timeout; none if one has come in time since."""

    async def exchange(self, address: int, block: Block, timeout_s: float) -> RegisterAnswer:
        """Send a request to a unit; return its answer or refusal, NoAnswerError if neither comes intact in time."""
        request = encode(address, block)
        async with self._held():
            asked_s, came, received = uptime_s(), b"", b""
            self.port.send(request)
            while (left_s := asked_s + timeout_s - uptime_s()) > 0:
                came += (arrived := await self.port.receive(left_s))
                received = came.replace(request, b"")  # adapters may echo
                start = max(0, len(received) - len(arrived) - MAX_FRAME_BYTES)
                for end, data in answers_of(address, received, start):
                    if answer := answer_to(block, data, asked_s):
                        self.port.traffic.note_frame(uptime_s())
                        begin = end - len(data) - ENVELOPE_BYTES
                        self._take_unexpected(received[:begin])
                        self._take_unexpected(received[end:])
                        self._late_s.pop(address, None)
                        if _logger.isEnabledFor(logging.DEBUG):
                            self._debug_answer(address, block, came, (begin, end), answer)
                        else:
                            self._earlier = None
                        return answer
            self._note(received)
            self._debug_silence(address, block, came, timeout_s)
            self._earlier = Request(address, block, asked_s)
        within = f"within {timeout_s * 1e3:.0f} ms"
        is_late = uptime_s() - self._late_s.get(address, -math.inf) < LATE_S
        if any(answers_of(address, received)) or (is_late and not received):
            raise NoAnswerError(f"unit {address} answers, but not {within}: its answers come late", Failure.LATE)
        if received:
            raise NoAnswerError(f"unit {address} does not answer intact {within}", Failure.DAMAGED)
        raise NoAnswerError(f"unit {address} does not answer {within}")

    async def is_quiet(self, address: int, timeout_s: float) -> bool:
        """Listen for answers of a unit to an earlier program; return whether none came."""
        until_s = uptime_s() + min(max(timeout_s, QUIET_S[0]), QUIET_S[1])
        async with self._held() as unexpected:
            received = unexpected
            while (left_s := until_s - uptime_s()) > 0:
                received += await self.port.receive(left_s)
            received += self.port.take()  # a busy machine reads late
        codes = [code for function in READ_FUNCTIONS for code in (function, function | 0x80)]
        return not any(bytes([address, code]) in received for code in codes)

    def _note(self, received: bytes) -> None:
        """Note what came beside the answers: frames of other units, or something else."""
        senders = senders_of(received[-RECENT_BYTES:])
        self._answering |= senders
        if senders:
            self.port.traffic.note_frame(uptime_s())
        else:
            self.port.traffic.note_other(received)

    def _debug_answer(
        self, address: int, block: Block, came: bytes, place: tuple[int, int], answer: RegisterAnswer
    ) -> None:
        """Write an answer to the debug log, and what came beside it; without echo, it begins and ends at `place`."""
        now_s, request, (begin, end) = uptime_s(), encode(address, block), place
        received = came.replace(request, b"")
        request_sent = Request(address, block, answer.asked_s, received[begin:end])
        beside = describe_beside(
            received[:begin], received[end:], request_sent, self._earlier, now_s, is_echoed=received != came
        )
        remarks = [exception_words(answer.exception)] if answer.exception else []
        remark = "".join(f"; {words}" for words in (*remarks, beside) if words)
        asked, took_ms = describe_request(address, block, request), (now_s - answer.asked_s) * 1e3
        words = "%s: %s; answered after %.1f ms (%s)%s"
        _logger.debug(words, self.port.path, asked, took_ms, in_hex(came), remark)
        self._answering.add(address)
        self._earlier = request_sent

    def _debug_silence(self, address: int, block: Block, came: bytes, timeout_s: float) -> None:
        """Write to the debug log that no answer came, what came instead, and what to check."""
        if _logger.isEnabledFor(logging.DEBUG):
            now_s, request, path = uptime_s(), encode(address, block), self.port.path
            has_answered, remark = address in self._answering, ""
            instead = describe_received(came, request, address, self._earlier, now_s, has_answered=has_answered)
            if not came.replace(request, b""):
                others = bool(self._answering - {address})
                advice = describe_silence(path, address, has_answered=has_answered, others_answer=others)
                remark = f"; {advice}"
            last, asked = self.port.traffic.describe_last_frame(now_s), describe_request(address, block, request)
            words = "%s: %s; no answer within %.0f ms: %s; %s%s"
            _logger.debug(words, path, asked, timeout_s * 1e3, instead, last, remark)

    @asynccontextmanager
    async def _held(self) -> AsyncIterator[bytes]:
        """Hold the line, once it has been silent for long enough; give what came unexpectedly."""
        async with self._lock:
            await asyncio.sleep(max(0.0, self._free_s - uptime_s()))
            unexpected = self.port.take()
            recent = unexpected[-RECENT_BYTES:]
            if unexpected and _logger.isEnabledFor(logging.DEBUG):
                words = describe_received(recent, earlier=self._earlier, now_s=self.port.taken_s)
                _logger.debug("%s: before a request %s", self.port.path, words)
            self._note(unexpected)
            if self._earlier is not None and not self._earlier.answer and holds_answer(recent, self._earlier):
                self._late_s[self._earlier.address] = uptime_s()
            self._take_unexpected(recent)
            try:
                yield unexpected
            finally:
                self._free_s = uptime_s() + self._silence_s


@dataclass(frozen=True, slots=True)
class UnitLine:
    """The way to one unit on a line."""

    line: RtuLine
    address: int
    timeout_s: float

    async def ask(self, block: Block) -> RegisterAnswer:
        """Send a request, again while its refusal may pass; NoAnswerError if no answer comes intact in time."""
        return await insist(self.ask_once, block)

    async def ask_once(self, block: Block) -> RegisterAnswer:
        """Send a request; return its answer or refusal, NoAnswerError if neither comes intact in time."""
        return await self.line.exchange(self.address, block, self.timeout_s)

    async def is_quiet(self) -> bool:
        """Listen for answers that nobody asked for; return whether none came."""
        return await self.line.is_quiet(self.address, self.timeout_s)
