"""Small devices that do as they are told: late, silent, damaged or reset."""

import asyncio
import dataclasses
import struct
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, closing, suppress
from functools import partial

from pymodbus.framer.rtu import FramerRTU
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
from pymodbus.simulator.simdevice import SimAction

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.tasks import cancel
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

from .lines import SerialConverter, Terminal

Pieces = list[tuple[float, bytes]]
"""How long a device is busy [s] and what it sends then, one after the other."""
Fault = Callable[[int, bytes], Pieces]
"""Takes the number of a request and the frame that answers it; returns what the device makes of it."""


def no_fault(_number: int, frame: bytes) -> Pieces:
    return [(0.0, frame)]


def no_echo(_request: bytes) -> Pieces:
    return []


class StampingUnit:
    """A Modbus unit whose registers hold the time, in ms since it was made, at which the request came."""

    def __init__(self, fault: Fault = no_fault) -> None:
        self.start_s = uptime_s()
        self.requests = 0
        self._fault = fault

    def age_s(self, counts: float, taken_s: float) -> float:
        """Return how much older a value is than its reading says."""
        return taken_s - self.start_s - counts / 1e3

    def value(self) -> int:
        """Return what the registers hold now."""
        return round((uptime_s() - self.start_s) * 1e3)

    def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
        """Take unit, function, address and count; return what the device sends, `wrap` making a frame of an answer."""
        unit, function, _, count = struct.unpack(">BBHH", request)
        value = self.value()
        answer = struct.pack(f">BBB{count}H", unit, function, 2 * count, *[value] * count)
        self.requests += 1
        return self._fault(self.requests, wrap(answer))


class NumberingUnit(StampingUnit):
    """A Modbus unit whose registers hold the number of the request, from 0: one that was taken for another is seen."""

    def value(self) -> int:
        """Return how many requests came before."""
        return self.requests

    @property
    def newest(self) -> int:
        """The value in the answer to the newest request."""
        return self.requests - 1


class RestingUnit(StampingUnit):
    """A Modbus unit whose registers hold the counts of a beam at rest."""

    def value(self) -> int:
        return 20_000


class RefusingUnit(RestingUnit):
    """A unit that refuses each `every`-th request with an exception."""

    def __init__(self, exception: int, every: int) -> None:
        super().__init__()
        self._exception, self._every = exception, every

    def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
        pieces = super().answer(request, wrap)
        if self.requests % self._every:
            return pieces
        return [(0.0, wrap(bytes([request[0], request[1] | 0x80, self._exception])))]


class RegisterUnit(StampingUnit):
    """A unit with so many input registers and holding registers from 0, all 0. It refuses others, as real ones do."""

    def __init__(self, inputs: int, holdings: int) -> None:
        super().__init__()
        self._has = {4: inputs, 3: holdings}

    def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
        unit, function, first, count = struct.unpack(">BBHH", request)
        if first + count > self._has.get(function, 0):
            return [(0.0, wrap(bytes([unit, function | 0x80, 2])))]
        return [(0.0, wrap(bytes([unit, function, 2 * count]) + bytes(2 * count)))]


def with_crc(frame: bytes) -> bytes:
    return frame + FramerRTU.compute_CRC(frame).to_bytes(2, "big")


def with_header(request_header: bytes, answer: bytes) -> bytes:
    return request_header[:4] + struct.pack(">H", len(answer)) + answer


def write_in_time(line: Terminal | SerialConverter, pieces: Pieces) -> None:
    """Write what an adapter sends by itself, each piece so long after now."""
    for after_s, piece in pieces:
        if after_s:
            asyncio.get_running_loop().call_later(after_s, line.write, piece)
        else:
            line.write(piece)


@asynccontextmanager
async def rtu_units(
    line: Terminal | SerialConverter,
    units: Mapping[int, StampingUnit],
    unanswered: list[int] | None = None,
    echo: Callable[[bytes], Pieces] = no_echo,
) -> AsyncIterator[None]:
    """Units by address on a serial line, each answering one request after the other, as real devices do.

    The addresses of requests to others are put into `unanswered`. `echo` is what the adapter makes of a request.
    """
    answers: dict[int, asyncio.Queue[Pieces]] = {address: asyncio.Queue() for address in units}
    buffer = bytearray()

    def receive(data: bytes) -> None:
        buffer.extend(data)
        while len(buffer) >= 8:
            request = bytes(buffer[:6])
            if with_crc(request) != buffer[:8]:
                del buffer[0]  # it was no request
                continue
            write_in_time(line, echo(bytes(buffer[:8])))
            del buffer[:8]
            if request[0] in units:
                answers[request[0]].put_nowait(units[request[0]].answer(request, with_crc))
            elif unanswered is not None:
                unanswered.append(request[0])

    async def reply(queue: asyncio.Queue[Pieces]) -> None:
        while True:
            for busy_s, piece in await queue.get():
                await asyncio.sleep(busy_s)
                line.write(piece)

    line.on_data(receive)
    tasks = [asyncio.create_task(reply(queue)) for queue in answers.values()]
    try:
        yield
    finally:
        await cancel(tasks)


@asynccontextmanager
async def tcp_unit(unit: StampingUnit, *, closes: bool = False) -> AsyncIterator[int]:
    """The unit behind a Modbus TCP socket, which it `closes` after each answer or not; gives its port."""
    busy = asyncio.Lock()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with closing(writer), suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                header = await reader.readexactly(6)
                wrap = partial(with_header, header)
                pieces = unit.answer(await reader.readexactly(6), wrap)
                async with busy:
                    for busy_s, piece in pieces:
                        await asyncio.sleep(busy_s)
                        writer.write(piece)
                if closes:
                    return

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()


@asynccontextmanager
async def pymodbus_server(
    registers: list[int], action: SimAction | None = None, port: int = 0, host: str = "127.0.0.1"
) -> AsyncIterator[int]:
    """pymodbus's own server with input registers from address 0 of unit 1; gives its port."""
    data = SimData(0, values=registers, datatype=DataType.REGISTERS)
    server = ModbusTcpServer(SimDevice(1, simdata=[data], action=action), address=(host, port))
    await server.serve_forever(background=True)
    listener = server.transport
    assert isinstance(listener, asyncio.Server)
    try:
        yield listener.sockets[0].getsockname()[1]
    finally:
        await server.shutdown()  # type: ignore[no-untyped-call]  # pymodbus leaves it without annotations


class SerialDevice:
    """A device that speaks our protocol on a pseudo-terminal; counts hold the number of the reading."""

    def __init__(
        self,
        line: Terminal | SerialConverter,
        boot_id: int = 1,
        channels: int = 2,
        schema_hash: int = SCHEMA_HASH,
        adc_bits: int = 16,
    ) -> None:
        self.received: list[Message] = []
        self.sequence = 0
        self.unsent = 0
        """Messages for which the line had no room, as a starved host did not read it."""
        self._line = line
        self._start_s = uptime_s()
        self._hello = Hello(PROTOCOL_VERSION, schema_hash, boot_id, channels, adc_bits, 1000)
        self._decoder = Decoder()
        self._stream: asyncio.Task[None] | None = None
        line.on_data(self._receive)

    def _receive(self, data: bytes) -> None:
        for message in self._decoder.feed(data):
            self.received.append(message)
            match message:
                case HelloRequest():
                    self.send(self._hello)
                case Ping(token):
                    self.send(Pong(token, self.device_us()))
                case Start(rate_hz, oversampling):
                    self.stop()
                    self._stream = asyncio.create_task(self._run(rate_hz, oversampling))
                case Stop():
                    self.stop()

    def send(self, message: Message) -> None:
        self.unsent += not self._line.write(encode(message))

    def restart(self, rate_hz: int) -> None:
        """Send readings though no host asked."""
        self.stop()
        self._stream = asyncio.create_task(self._run(rate_hz, 1))

    def stop(self) -> None:
        if self._stream:
            self._stream.cancel()
            self._stream = None

    def lose(self, number: int) -> None:
        """Skip readings, as if their frames had been lost."""
        self.sequence += number

    def set_back(self, seconds: float) -> None:
        """Set the clock back while the readings go on."""
        self._start_s += seconds

    def reset(self, boot_id: int) -> None:
        """Start over, as after a power failure, and say so."""
        self.stop()
        self.sequence = 0
        self._hello = dataclasses.replace(self._hello, boot_id=boot_id)
        self.send(self._hello)

    def device_us(self) -> int:
        """Return the device's clock, which wraps 65 ms after it was made."""
        return self.device_us_at(uptime_s())

    def device_us_at(self, host_s: float) -> int:
        """Return the same at a time of `uptime_s`."""
        return (round((host_s - self._start_s) * 1e6) + 0xFFFF_0000) % 2**32

    def known_clock(self) -> str:
        """Return code by which a daemon knows this clock exactly, as it nearly does where pings are answered at once.

        On a starved machine they are not. Then the times of readings are off by up to a ping, each by another part of
        it, and a rate over some hundred readings by percents.
        """
        host_s = f"{self._start_s!r} + (device_s - {0xFFFF_0000 / 1e6}) % {2**32 / 1e6}"
        return (
            "from beamtouch_daemon.sources.clock import HostClock; "
            f"HostClock.to_host = lambda self, device_s, arrival_s: {host_s}"
        )

    def counts(self, sequence: int) -> tuple[int, ...]:
        """Return what one conversion of each channel gives in a reading."""
        base = 20_000 if self._hello.adc_bits == 16 else 2000
        return tuple(base + sequence + 1000 * i for i in range(self._hello.channel_count))

    async def _run(self, rate_hz: int, oversampling: int) -> None:
        while True:
            counts = tuple(oversampling * count for count in self.counts(self.sequence))
            self.send(Reading(self.sequence % 2**16, self.device_us(), oversampling, counts))
            self.sequence += 1
            await asyncio.sleep(1 / rate_hz)
