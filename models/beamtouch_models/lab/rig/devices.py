"""The devices that measure the virtual surface.

A Modbus module has one value per channel, in consecutive registers. Two devices speak the serial protocol
(PROTOCOL.md): one of this process, and the reference firmware on the simulated board (`firmware_protocol/simulator`).
"""

import asyncio
import os
import secrets
import struct
import time
from asyncio.subprocess import PIPE
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from pymodbus.constants import ExcCodes
from pymodbus.exceptions import NoSuchIdException
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from beamtouch_common.errors import InputError
from beamtouch_models.errors import SceneError
from beamtouch_models.lab.rig.lines import Relay, read, remove_left_behind, write
from beamtouch_protocol.framing import DELIMITER, Decoder, encode
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

BAUD = 115_200
TYPES = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f", "f64": ">d"}

Convert = Callable[[], list[int]]
"""Converts all channels now and returns their counts."""


@dataclass(frozen=True)
class Module:
    """Registers and form of a module's values, in the words of the daemon's configuration."""

    unit: int = 1
    function: Literal[3, 4] = 4
    register: int = 0
    """Address of the first register, from 0."""
    type: str = "u16"
    byte_order: str = "ABCD"

    def check(self, channels: int, adc_bits: int) -> None:
        """Raise InputError unless the counts of all channels fit into the registers."""
        largest = 2**adc_bits - 1
        try:
            words = len(self.registers_of([largest] * channels))
        except struct.error:
            message = f"counts up to {largest} do not fit --type {self.type}; set sensors.adc_bits = 15 in the scene"
            raise InputError(message) from None
        if self.register + words > 2**16:
            raise InputError(f"--register {self.register}: {words} registers from there go beyond 65535")

    def registers_of(self, counts: list[int]) -> list[int]:
        """Return the registers of these counts."""
        data = b"".join(struct.pack(TYPES[self.type], count) for count in counts)
        words = [int.from_bytes(data[start : start + 2]) for start in range(0, len(data), 2)]
        if self.byte_order in ("CDAB", "DCBA"):
            last = struct.calcsize(TYPES[self.type]) // 2 - 1
            words = [words[index ^ last] for index in range(len(words))]
        if self.byte_order in ("BADC", "DCBA"):
            words = [word >> 8 | (word & 0xFF) << 8 for word in words]
        return words


def tcp_server(convert: Convert, channels: int, module: Module, host: str, port: int) -> ModbusTcpServer:
    """Return a Modbus TCP server, not yet listening. To requests for another unit it answers exception 11."""
    return ModbusTcpServer(_devices(convert, channels, module), address=(host, port))


def rtu_server(convert: Convert, channels: int, module: Module, port: str) -> ModbusSerialServer:
    """Return a Modbus RTU server on a serial port, not yet listening. It is silent on requests for another unit."""
    devices = _devices(convert, channels, module)
    return ModbusSerialServer(devices, port=port, baudrate=BAUD, ignore_missing_devices=True)


def _devices(convert: Convert, channels: int, module: Module) -> list[SimDevice]:
    async def action(  # the signature is pymodbus's
        function_code: int,
        _start_address: int,
        _address: int,
        _count: int,
        current_registers: list[int],
        _set_values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        if function_code != module.function:
            return ExcCodes.ILLEGAL_FUNCTION
        # Convert on request, as modules that sample on demand do, so that successive readings are independent.
        current_registers[:] = module.registers_of(convert())
        return None

    async def refuse(*_request: object) -> ExcCodes | None:
        raise NoSuchIdException

    def device(unit: int, first: int, count: int, act: Callable[..., object]) -> SimDevice:
        registers = SimData(address=first, count=count, values=0, datatype=DataType.REGISTERS)
        return SimDevice(id=unit, simdata=[registers], action=act)  # type: ignore[arg-type]

    count = len(module.registers_of([0] * channels))
    own = device(module.unit, module.register, count, action)
    # pymodbus takes unit 0 for all units that have no device of their own.
    return [own] if module.unit == 0 else [own, device(0, 0, 2**16, refuse)]


MAX_RATE_HZ = 2000


class SerialDevice:
    """A device of the serial protocol on a non-blocking file descriptor.

    Parameters
    ----------
    line : descriptor of the device's end of the line
    convert : converts all channels now and returns their counts
    channels, adc_bits : stated in the hello
    relay : passes frames on
    """

    def __init__(self, line: int, convert: Callable[[], list[int]], channels: int, adc_bits: int, relay: Relay) -> None:
        self._line, self._relay = line, relay
        self._convert = convert
        self._hello = Hello(PROTOCOL_VERSION, SCHEMA_HASH, secrets.randbits(32), channels, adc_bits, MAX_RATE_HZ)
        self._max_oversampling = 65535 // (2**adc_bits - 1)
        self._decoder = Decoder()
        self._stream: asyncio.Task[None] | None = None
        self._sequence = 0
        self._boot = time.monotonic()

    async def serve(self) -> None:
        """Send a hello, then serve until cancelled."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._line, self._receive)
        os.write(self._line, DELIMITER)  # ends a partial frame on the line
        self._send(self._hello)
        try:
            await asyncio.Event().wait()
        finally:
            loop.remove_reader(self._line)
            self._stop()

    def _receive(self) -> None:
        data = read(self._line)
        self._relay.request(lambda: self._take(data))

    def _take(self, data: bytes) -> None:
        for message in self._decoder.feed(data):
            self._handle(message)

    def _handle(self, message: Message) -> None:
        match message:
            case HelloRequest():
                self._send(self._hello)
            case Ping(token):
                self._send(Pong(token, self._device_us()))
            case Start(rate, oversampling) if 1 <= rate <= MAX_RATE_HZ and 1 <= oversampling <= self._max_oversampling:
                self._stop()
                self._stream = asyncio.get_running_loop().create_task(self._send_readings(rate, oversampling))
            case Stop():
                self._stop()
            case _:
                pass  # a device ignores all other messages, as PROTOCOL.md says

    def _stop(self) -> None:
        if self._stream is not None:
            self._stream.cancel()
            self._stream = None

    def _device_us(self) -> int:
        return round((time.monotonic() - self._boot) * 1e6) % 2**32

    async def _send_readings(self, rate_hz: int, oversampling: int) -> None:
        """Send readings on a schedule without drift; missed slots are skipped, and their numbers with them."""
        start, slot = time.monotonic(), 0
        while True:
            await self._relay.idle()
            device_us = self._device_us()
            sums = map(sum, zip(*(self._convert() for _ in range(oversampling)), strict=True))
            self._send(Reading(self._sequence, device_us, oversampling, tuple(sums)))
            before, slot = slot, max(slot + 1, int((time.monotonic() - start) * rate_hz))
            self._sequence = (self._sequence + slot - before) % 2**16
            await asyncio.sleep(max(0.0, start + slot / rate_hz - time.monotonic()))

    def _send(self, message: Message) -> None:
        frame = encode(message)
        self._relay.reply(lambda: write(self._line, frame))


ADC_BITS = 10
SUPPLY_MV = 5000
_UPDATE_S = 0.002


async def start_board(board: Path, elf: Path, line: Path, outputs: Callable[[], Sequence[float]]) -> Awaitable[None]:
    """Start a board program with its firmware image and its serial line at `line`.

    Returns what sets its voltages to the sensor outputs, 0 to 1, until it is cancelled; SceneError if the board ends.

    Raises
    ------
    SceneError
        The board does not start; it has printed the reason.
    OSError
        The board is not an executable file.
    """
    remove_left_behind(line)
    process = await asyncio.create_subprocess_exec(str(board), str(elf), "--link", str(line), stdin=PIPE, stdout=PIPE)
    voltages, announced = cast(asyncio.StreamWriter, process.stdin), cast(asyncio.StreamReader, process.stdout)
    if not await announced.readline():
        voltages.close()
        await process.wait()  # the board has closed its output, so it is about to end
        raise SceneError(f"the simulated board {board} did not start")

    async def serve() -> None:
        try:
            while not voltages.is_closing():
                voltages.write((" ".join(map(_millivolts, outputs())) + "\n").encode())
                await voltages.drain()
                await asyncio.sleep(_UPDATE_S)
        except ConnectionError:
            pass
        finally:
            with suppress(ConnectionError):
                voltages.close()  # this ends the board
            await process.wait()
        raise SceneError("the simulated board ended unexpectedly")

    return serve()


def _millivolts(output: float) -> str:
    """Return the voltage of an output, half a count higher: the chip's ADC rounds down, the rig's to the nearest."""
    half_count = 0.5 / (2**ADC_BITS - 1)
    return str(round(min(output + half_count, 1.0) * SUPPLY_MV))
