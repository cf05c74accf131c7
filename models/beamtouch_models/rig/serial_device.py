"""A device that measures the virtual surface and speaks the serial protocol (PROTOCOL.md)."""

import asyncio
import os
import secrets
import time
from collections.abc import Callable

from beamtouch_models.rig.lines import Relay, read, write
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
