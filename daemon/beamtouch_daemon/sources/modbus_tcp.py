"""Modbus units over TCP."""

import asyncio
import logging
import math
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager, asynccontextmanager, closing, nullcontext

from pymodbus.framer import FramerSocket

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.config.sources import ModbusTcp
from beamtouch_daemon.sources.converter import connect
from beamtouch_daemon.sources.frame_diagnosis import describe_request, in_hex
from beamtouch_daemon.sources.host_address import HostAddress, UnknownHostError, no_connection
from beamtouch_daemon.sources.reading import NoAnswerError, SourceError
from beamtouch_daemon.sources.registers import DECODER, Block, RegisterAnswer, answer_to
from beamtouch_daemon.sources.requests import Failure, Requests, exception_words, insist
from beamtouch_daemon.sources.rtu_frames import answers_of
from beamtouch_daemon.sources.rtu_line import RtuLine
from beamtouch_daemon.sources.serial_port import SerialPort

REST_S = 0.5
"""Pause between attempts to reach a unit that was given up."""
HEADER_BYTES = 7
"""Transaction, protocol, length and unit."""
UNCOUNTED_BYTES = 6
"""Those before the unit; the length counts the others."""
READ_BYTES = 4096
"""Largest number of bytes that one read takes."""
DEVICE_ITSELF = (0, 255)
"""Unit numbers of the device at the other end of the connection, as opposed to units behind it."""
QUICK_S = 0.1
"""A refusal that takes longer is not followed by another request in the same slot: a gateway has waited in vain for its
unit, and the other units wait with it."""
LOOK_AGAIN_S = 60.0
"""A device that has never answered is asked in RTU frames, too: once in this time."""
_FRAMER = FramerSocket(DECODER)
_logger = logging.getLogger(__name__)


class TcpLink:
    """A unit behind a Modbus TCP server.

    Within a connection, transaction numbers tell answers apart. An answer with transaction number 0, which some devices
    always send, is refused, and so is that of another unit: behind a gateway it comes from another device. A device
    that always answers as unit 0 or 255 is accepted. A missing answer closes the connection, which discards a late one.
    """

    limits: tuple[str, ...] = ()
    boots_until_s = -math.inf
    """A connection resets no device."""
    observed = ""
    """The reason of a failure says all that is known."""

    def __init__(self, settings: ModbusTcp, host: str, unit: int) -> None:
        self.name = f"unit {unit}" if host == settings.host else f"{host} unit {unit}"
        self.rest_s = REST_S
        self.requests = Requests()
        self._timeout_s = settings.timeout_s
        self._address = HostAddress(host, settings.port)
        self._unit = unit
        self._transaction = 0
        self._stream: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._received = b""
        """Bytes since the newest request that are no whole frame."""
        self._mismatch = ""
        """Reason why the frames that came since then are no answer to it; empty if none came."""
        self._has_answered = False
        self._looks_again_s = -math.inf
        """Time from which on the device may be asked in RTU frames."""
        self._answers_in_rtu = False
        """True if it did so last time."""

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        """Connect at the first read; disconnect at the end."""
        try:
            yield
        finally:
            self._close()

    def kept_open(self) -> AbstractContextManager[None]:
        """Do nothing: a new connection resets no device."""
        return nullcontext()

    async def read(self, block: Block) -> RegisterAnswer:
        """Read registers, connecting first if necessary; ask again while a refusal may pass."""
        try:
            answer = await insist(self.ask, block, QUICK_S)
        except NoAnswerError as error:
            if error.failure == Failure.SILENT and await self._is_converter(block):
                raise self._converter_error() from error
            raise
        self._has_answered = True
        return answer

    async def ask(self, block: Block) -> RegisterAnswer:
        """Send a request, connecting first if necessary; NoAnswerError if no answer comes in time."""
        try:
            answer = await self._exchange(block)
        except TimeoutError as error:
            self._close()
            raise self._debugged(self._explain_silence()) from error
        except (OSError, EOFError) as error:
            self._close()
            why = NoAnswerError(f"{self._address} closes the connection without an answer", Failure.CLOSED)
            raise self._debugged(why) from error
        except BaseException:  # cancelled: the answer may still come
            self._close()
            raise
        if answer is None:
            self._close()
            raise self._debugged(NoAnswerError(f"{self.name} answered another request", Failure.FOREIGN))
        if answer.exception:
            _logger.debug("%s: %s: %s", self._address, self.name, exception_words(answer.exception))
        return answer

    def _debugged(self, failure: NoAnswerError) -> NoAnswerError:
        """Write to the debug log why there is no answer, and return that."""
        _logger.debug("%s: %s", self._address, failure)
        return failure

    async def _exchange(self, block: Block) -> RegisterAnswer | None:
        """Send a request and return its answer; None if it does not fit.

        Some devices close a connection after each answer or after some time, perhaps just now. So if one ends that has
        been used before, the request is sent again on a new one.
        """
        while True:
            reader, writer, is_new = await self._connected()
            self._transaction = self._transaction % 0xFFFF + 1
            self._received, self._mismatch = b"", ""
            asked_s = uptime_s()
            try:
                request = _FRAMER.encode(block.request, self._unit, self._transaction)
                if _logger.isEnabledFor(logging.DEBUG):
                    _logger.debug("%s: %s", self._address, describe_request(self._unit, block, request))
                writer.write(request)
                async with asyncio.timeout(self._timeout_s):
                    return answer_to(block, await self._receive(reader), asked_s)
            except (ConnectionError, EOFError):
                if is_new:
                    raise
                self._close()

    async def _receive(self, reader: asyncio.StreamReader) -> bytes:
        """Return function and contents of the answer to the newest request."""
        while True:
            end = UNCOUNTED_BYTES + int.from_bytes(self._received[4:6])
            is_foreign = self._received[2:4] not in (b"", b"\0\0")
            if is_foreign or len(self._received) < max(HEADER_BYTES, end):
                if not (data := await reader.read(READ_BYTES)):
                    raise EOFError
                if _logger.isEnabledFor(logging.DEBUG):
                    _logger.debug("%s: %d bytes came (%s)", self._address, len(data), in_hex(data))
                self._received += data
                continue
            _, unit, transaction, data = _FRAMER.decode(self._received[:end])
            self._received = self._received[end:]
            if transaction == self._transaction and unit in (self._unit, *DEVICE_ITSELF):
                return data
            self._mismatch = "answers with the transaction number of another request"
            if transaction == self._transaction:
                self._mismatch = f"answers as unit {unit}; state unit = {unit} if that is the device"
            elif not transaction:
                self._mismatch = "answers with transaction number 0, which does not identify the request"

    def _explain_silence(self) -> NoAnswerError:
        """Return why no answer came in time."""
        if any(answers_of(self._unit, self._received)):
            return self._converter_error()
        if self._mismatch:
            return NoAnswerError(f"{self.name} {self._mismatch}", Failure.FOREIGN)
        within = f"within {self._timeout_s * 1e3:.0f} ms"
        if self._received:
            return NoAnswerError(f"{self.name} does not answer intact {within}", Failure.DAMAGED)
        return NoAnswerError(f"{self.name} does not answer {within}")

    async def _is_converter(self, block: Block) -> bool:
        """Return whether a device that has never answered passes on RTU frames instead."""
        if not self._has_answered and uptime_s() >= self._looks_again_s:
            self._looks_again_s = uptime_s() + LOOK_AGAIN_S
            self._answers_in_rtu = await _answers_in_rtu(self._address, self._unit, block, self._timeout_s)
        return self._answers_in_rtu and not self._has_answered

    def _converter_error(self) -> NoAnswerError:
        text = f"{self._address} is a serial converter: it passes on RTU frames, and {self.name} answers in such frames"
        return NoAnswerError(
            f'{text}; write kind = "modbus-rtu" and port = "tcp://{self._address}" in its source', Failure.FOREIGN
        )

    async def _connected(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, bool]:
        """Return the connection, and whether it is new; NoAnswerError if there is none."""
        if self._stream is not None:
            reader, writer = self._stream
            if not reader.at_eof() and not writer.is_closing():
                return reader, writer, False
            self._close()
        try:
            host = await self._address.resolve(self._timeout_s)
            async with asyncio.timeout(self._timeout_s):
                reader, writer = self._stream = await asyncio.open_connection(host, self._address.port)
        except UnknownHostError as error:
            raise NoAnswerError(str(error), Failure.UNREACHABLE) from error
        except OSError as error:  # also a timeout
            raise NoAnswerError(no_connection(self._address), Failure.UNREACHABLE) from error
        return reader, writer, True

    def _close(self) -> None:
        if self._stream is not None:
            self._stream[1].transport.abort()
            self._stream = None


async def _answers_in_rtu(address: HostAddress, unit: int, block: Block, timeout_s: float) -> bool:
    """Return whether a unit answers a request in an RTU frame over a connection of its own. It only reads."""
    try:
        with closing(SerialPort(f"tcp://{address}", await connect(address))) as port:
            await RtuLine(port, 0.0).exchange(unit, block, timeout_s)
    except (NoAnswerError, SourceError):
        return False
    return True
