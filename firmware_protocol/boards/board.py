"""A Beamtouch board in MicroPython: reads the sensors and speaks PROTOCOL.md on the board's USB port.

For boards with an RP2040 or ESP32. Edit the four settings below, then copy this file to the board as main.py:

    mpremote cp board.py :main.py + reset
"""

import binascii
import gc
import os
import select
import struct
import sys
import time

import machine
import micropython

ADS1115_ADDRESSES = (0x48,)  # ADS1115 chips on I2C, four channels each (A0 to A3, in this order); () for none
ADC_PINS = ()  # without such chips: pins of the board's own ADC in channel order, as (26, 27, 28) on a Pico
I2C = {"id": 0, "scl": 5, "sda": 4}  # of the chips
LED = "LED"  # the pin that blinks after Identify; None for none

PROTOCOL_VERSION = 1
SCHEMA_HASH = 0x3D4A3321
HELLO_REQUEST, PING, IDENTIFY, START, STOP, HELLO, PONG, READING = 0x01, 0x02, 0x03, 0x10, 0x11, 0x81, 0x82, 0x90
REQUESTS = {HELLO_REQUEST: "<", PING: "<H", IDENTIFY: "<B", START: "<HB", STOP: "<"}
"""Payload of each message to a device."""
MAX_FRAME_BYTES = 9
"""The longest frame to a device, without its delimiter."""
BREAK = b"\r\x03"
"""What mpremote sends to interrupt a program. No frame to a device begins so: 13 is more than its length."""
MAX_SUM = 65535
LINE_BYTES_PER_S = 11520
"""Of a USB bridge at 115200 baud, as many ESP32 boards have it; USB of the chip itself is faster."""
MAX_PAUSE_MS = 100
MAX_HEARD_BYTES = 32
"""Bytes taken between two readings: a flood does not hold the readings up."""
CONVERSION_TIMEOUT_US = 10_000
BLINK_US = 125_000


def checksum(body: bytes) -> bytes:
    """Return the CRC-32 of a body as four bytes."""
    seed = 0 if body[0] in {HELLO_REQUEST, HELLO} else SCHEMA_HASH
    return struct.pack("<I", binascii.crc32(body, seed) & 0xFFFFFFFF)


def encode(body: bytes) -> bytes:
    """Return the frame of a body, with its delimiter."""
    pieces = (body + checksum(body)).split(b"\0")
    return b"".join([bytes([len(piece) + 1]) + piece for piece in pieces]) + b"\0"


def decode(frame: bytes) -> tuple:
    """Return type and fields of the message in a frame without its delimiter; an empty tuple if it is none."""
    content = b""
    while frame:
        length = frame[0]
        if length > len(frame):
            return ()
        content += b"\0" + frame[1:length]
        frame = frame[length:]
    body = content[1:-4]
    if not body or content[-4:] != checksum(body) or body[0] not in REQUESTS:
        return ()
    form = REQUESTS[body[0]]
    if len(body) != 1 + struct.calcsize(form):
        return ()
    message = [body[0]]
    message.extend(struct.unpack(form, body[1:]))
    return tuple(message)


class Decoder:
    """Finds messages in bytes; KeyboardInterrupt if somebody wants MicroPython's prompt."""

    def __init__(self) -> None:
        self._frame = b""
        self._is_overlong = False

    def feed(self, byte: bytes) -> tuple:
        """Return the message that this byte completes; an empty tuple if it completes none."""
        if byte == b"\0":
            frame = b"" if self._is_overlong else self._frame
            self._frame, self._is_overlong = b"", False
            return decode(frame)
        if len(self._frame) == MAX_FRAME_BYTES:
            self._is_overlong = True
        else:
            self._frame += byte
        if self._frame == BREAK:
            raise KeyboardInterrupt
        return ()


class Clock:
    """Microseconds since boot, without wraps, if asked every few minutes."""

    def __init__(self) -> None:
        self._ticks = time.ticks_us()
        self._us = 0

    def us(self) -> int:
        """Return the time."""
        ticks = time.ticks_us()
        self._us += time.ticks_diff(ticks, self._ticks)
        self._ticks = ticks
        return self._us


class OwnAdc:
    """The ADC of the board: 12 bits."""

    bits = 12
    nominal_us = 0

    def __init__(self, pins: tuple) -> None:
        self._inputs = [machine.ADC(machine.Pin(pin)) for pin in pins]
        for one in self._inputs:
            if hasattr(one, "atten"):  # an ESP32 measures up to 1 V otherwise
                one.atten(machine.ADC.ATTN_11DB)

    def convert(self, oversampling: int) -> list:
        """Return the sum of this many conversions of each channel."""
        sums = [0] * len(self._inputs)
        for _ in range(oversampling):
            for channel, one in enumerate(self._inputs):
                sums[channel] += one.read_u16() >> 4
        return sums


class Ads1115Chips:
    """ADS1115 chips: 15 bits from 0 to 4.096 V.

    Registers and bits as in the data sheet: 0 is the conversion, 1 the configuration.
    """

    bits = 15
    nominal_us = 4 * 1600
    """Four conversions, which take up to 1.28 ms each, and their transfers."""

    def __init__(self, bus: object, addresses: tuple) -> None:
        self._bus, self._addresses = bus, addresses
        self._word = bytearray(2)

    def convert(self, oversampling: int) -> list:
        """Return the sum of this many conversions of each channel; 0 for those of a chip that does not answer."""
        sums = [0] * (4 * len(self._addresses))
        silent = set()
        for _ in range(oversampling):
            for pin in range(4):
                for chip in range(len(self._addresses)):  # all convert at the same time
                    self._try(self._begin, chip, pin, silent)
                for chip in range(len(self._addresses)):
                    sums[4 * chip + pin] += self._try(self._finish, chip, pin, silent)
        for chip in silent:
            sums[4 * chip : 4 * chip + 4] = [0, 0, 0, 0]  # a host takes 0 for a missing cable
        return sums

    def _try(self, act: object, chip: int, pin: int, silent: set) -> int:
        if chip not in silent:
            try:
                return act(self._addresses[chip], pin)
            except OSError:
                silent.add(chip)
        return 0

    def _begin(self, address: int, pin: int) -> int:
        # Start one conversion of this pin against ground, to 4.096 V, at 860 per second, without the comparator.
        self._bus.writeto_mem(address, 1, struct.pack(">H", 0x8000 | (4 + pin) << 12 | 0x0200 | 0x0100 | 0x00E3))
        return 0

    def _finish(self, address: int, _: int) -> int:
        begin_us = time.ticks_us()
        is_late = False
        while True:
            self._bus.readfrom_mem_into(address, 1, self._word)
            if self._word[0] & 0x80:  # it converts no more
                self._bus.readfrom_mem_into(address, 0, self._word)
                return max(0, struct.unpack(">h", self._word)[0])  # noise around 0 V is negative
            if is_late:
                raise OSError("it does not finish")
            # Ask once more: an interrupt or another program may have taken the time.
            is_late = time.ticks_diff(time.ticks_us(), begin_us) >= CONVERSION_TIMEOUT_US


class Light:
    """The LED."""

    def __init__(self, pin: object) -> None:
        self._pin = None if pin is None else machine.Pin(pin, machine.Pin.OUT)
        self._until_us = 0

    def blink(self, until_us: int) -> None:
        """Blink until a time."""
        self._until_us = until_us

    def show(self, now_us: int) -> None:
        """Switch it on or off."""
        if self._pin is not None:
            self._pin.value(1 if now_us < self._until_us and now_us // BLINK_US % 2 else 0)


class Board:
    """The device: answers the host, and sends readings once it is asked to."""

    def __init__(self, inputs: object, light: Light) -> None:
        self._inputs, self._light = inputs, light
        self._clock, self._decoder = Clock(), Decoder()
        self._boot_id = os.urandom(4)
        self._sequence = 0
        self._rate_hz = 0  # 0: stopped
        self._oversampling = 1
        self._begin_us = self._due = 0
        self._measure()
        self._poll = select.poll()
        self._poll.register(sys.stdin, select.POLLIN)

    def run(self) -> None:
        """Serve the host for ever."""
        sys.stdout.buffer.write(b"\0")
        self._say_hello()
        while True:
            left_us = self._left_us()
            if self._poll.poll(max(0, left_us // 1000)):
                self._hear()
            if self._left_us() <= 0:
                self._send_reading()
            self._light.show(self._clock.us())

    def _measure(self) -> None:
        """Measure how fast this board is: conversions, all that a reading takes beside them, collecting garbage."""
        counts, convert_us, encode_us = [], [], []
        for _ in range(8):
            begin_us = self._clock.us()
            counts = self._inputs.convert(1)
            converted_us = self._clock.us()
            encode(struct.pack("<BHIB", READING, 0, 0, 1) + struct.pack("<" + len(counts) * "H", *counts))
            convert_us.append(converted_us - begin_us)
            encode_us.append(self._clock.us() - converted_us)
        begin_us = self._clock.us()
        gc.collect()
        self._collect_us = self._clock.us() - begin_us
        self._channels = len(counts)
        self._convert_us = max(min(convert_us), self._inputs.nominal_us, 1)
        # Sending, hearing and the loop take about as long as encoding.
        self._overhead_us = 3 * min(encode_us)
        line_hz = LINE_BYTES_PER_S * 9 // 10 // (14 + 2 * self._channels)
        self._max_rate_hz = max(1, min(line_hz, 800_000 // (self._convert_us + self._overhead_us)))

    def _left_us(self) -> int:
        """Return the time until the next reading is due; stopped, a pause."""
        if not self._rate_hz:
            return MAX_PAUSE_MS * 1000
        due_us = self._begin_us + self._due * 1_000_000 // self._rate_hz
        return min(due_us - self._clock.us(), MAX_PAUSE_MS * 1000)

    def _hear(self) -> None:
        for _ in range(MAX_HEARD_BYTES):
            message = self._decoder.feed(sys.stdin.buffer.read(1))
            if message:
                self._obey(message)
            if not self._poll.poll(0):
                return

    def _obey(self, message: tuple) -> None:
        kind = message[0]
        if kind == HELLO_REQUEST:
            self._say_hello()
        elif kind == PING:
            sys.stdout.buffer.write(encode(struct.pack("<BHI", PONG, message[1], self._clock.us() & 0xFFFFFFFF)))
        elif kind == IDENTIFY:
            self._light.blink(self._clock.us() + message[1] * 1_000_000)
        elif kind == START:
            self._start(message[1], message[2])
        elif kind == STOP:
            self._rate_hz = 0

    def _say_hello(self) -> None:
        body = struct.pack("<BBI", HELLO, PROTOCOL_VERSION, SCHEMA_HASH) + self._boot_id
        body += struct.pack("<BBH", self._channels, self._inputs.bits, self._max_rate_hz)
        sys.stdout.buffer.write(encode(body))

    def _start(self, rate_hz: int, oversampling: int) -> None:
        """Start to send readings, or change a running stream; ignore what cannot be kept."""
        busy_us = rate_hz * (oversampling * self._convert_us + self._overhead_us)
        is_kept = 1 <= rate_hz <= self._max_rate_hz and busy_us <= 1_000_000
        if is_kept and 1 <= oversampling <= MAX_SUM // (2**self._inputs.bits - 1):
            self._rate_hz, self._oversampling = rate_hz, oversampling
            self._begin_us, self._due = self._clock.us(), 0

    def _send_reading(self) -> None:
        begin_us = self._clock.us()
        number = (begin_us - self._begin_us) * self._rate_hz // 1_000_000
        if number > self._due:  # scans that were due and not taken have their numbers
            self._sequence += number - self._due
            self._due = number
        counts = self._inputs.convert(self._oversampling)
        middle_us = (begin_us + self._clock.us()) // 2
        body = struct.pack("<BHIB", READING, self._sequence & 0xFFFF, middle_us & 0xFFFFFFFF, self._oversampling)
        sys.stdout.buffer.write(encode(body + struct.pack("<" + self._channels * "H", *counts)))
        self._sequence += 1
        self._due += 1
        if self._left_us() > 2 * self._collect_us:
            gc.collect()  # now, rather than during a scan


def main() -> None:
    """Serve the host until somebody wants MicroPython's prompt; begin anew after any other error."""
    inputs = OwnAdc(ADC_PINS) if not ADS1115_ADDRESSES else None
    if inputs is None:
        bus = machine.I2C(I2C["id"], scl=machine.Pin(I2C["scl"]), sda=machine.Pin(I2C["sda"]), freq=400_000)
        inputs = Ads1115Chips(bus, ADS1115_ADDRESSES)
    board = Board(inputs, Light(LED))
    micropython.kbd_intr(-1)  # a 3 in a frame is no Ctrl-C
    try:
        board.run()
    except KeyboardInterrupt:
        micropython.kbd_intr(3)
    except Exception:  # noqa: BLE001 - whatever it is, the host meets a device that was reset
        machine.reset()


if __name__ == "__main__":
    main()
