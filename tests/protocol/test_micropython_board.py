"""The board in MicroPython follows PROTOCOL.md: its codec and its sessions, in a real MicroPython. Pins are played.

Machines of tests are busy, so nothing here depends on how late the board is.
"""

import os
import random
import select
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple
from itertools import pairwise
from pathlib import Path
from time import monotonic

import pytest

from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Hello, HelloRequest, Identify, Message, Ping, Pong, Reading, Start, Stop
from support.programs.micropython_board import BOARDS, ONE_CHIP, OWN_ADC, PARTS, TWO_CHIPS, micropython, plugged_in
from support.running.waiting import wait_until

from .codec_cases import GOLDEN, damage, golden_message, noise, random_message

CODEC = """
import binascii, sys
import board
for line in sys.stdin:
    act, given = line.split()
    given = binascii.unhexlify(given)
    if act == "encode":
        print(binascii.hexlify(board.encode(given)).decode())
    else:
        decoder, found = board.Decoder(), []
        for byte in given:
            try:
                message = decoder.feed(bytes([byte]))
            except KeyboardInterrupt:
                message = ()
            if message:
                found.append(" ".join(map(str, message)))
        print(",".join(found))
"""
"""Each line is for the codec: a body to encode, or a stream to decode with a decoder of its own."""
DROP_OUT = """
import machine, board
class Bus(machine.I2C):
    begun = 0
    def writeto_mem(self, address, register, data):
        self.begun += address == 0x49
        if address == 0x49 and self.begun == 6:
            raise OSError(19)
        super().writeto_mem(address, register, data)
chips = board.Ads1115Chips(Bus(0, scl=None, sda=None, freq=0), (0x48, 0x49))
for _ in range(2):
    print(*chips.convert(2))
"""
"""The second of two chips does not answer to the sixth conversion, in the second round of a reading of two."""
HANGING = """
import machine, board
class Bus(machine.I2C):
    def readfrom_mem_into(self, address, register, data):
        super().readfrom_mem_into(address, register, data)
        if address == 0x48 and register == 1:
            data[0] &= 0x7F
print(*board.Ads1115Chips(Bus(0, scl=None, sda=None, freq=0), (0x48, 0x49)).convert(1))
"""
"""The first of two chips never says that it has converted."""
TICKS = """
import board
class Ticks:
    now = (1 << 30) - 5_000_000
    def ticks_us(self):
        return self.now % (1 << 30)
    def ticks_diff(self, later, earlier):
        return (later - earlier + (1 << 29)) % (1 << 30) - (1 << 29)
board.time = ticks = Ticks()
clock = board.Clock()
for _ in range(12):
    ticks.now += 400_000_000
    print(clock.us())
"""
"""The ticks of a board that wrap after 18 minutes; those of this machine never do."""
PACE = """
import board
class Ticks:
    now = 0
    def ticks_us(self):
        return self.now
    def ticks_diff(self, later, earlier):
        return later - earlier
class Inputs(board.OwnAdc):
    def __init__(self, channels, us, nominal_us=0):
        self.channels, self.us, self.nominal_us = channels, us, nominal_us
    def convert(self, oversampling):
        board.time.now += self.us
        return [0] * self.channels
board.time = Ticks()
encode = board.encode
def encode_for(us):
    def slow(body):
        board.time.now += us
        return encode(body)
    return slow
chips_us = board.Ads1115Chips.nominal_us
for channels, us, nominal_us, encode_us in (
    (3, 9_700, 0, 100), (4, 500, chips_us, 0), (16, 500, chips_us, 0), (16, 500, 0, 0), (3, 2_000_000, 0, 0)
):
    board.encode = encode_for(encode_us)
    print(board.Board(Inputs(channels, us, nominal_us), board.Light(None))._max_rate_hz)
"""
"""Boards whose conversions take a known time; what goes on beside them takes three times as long as encoding."""
ONE_TAKES_LONG = """
import board, time
convert = board.OwnAdc.convert
def slow(self, oversampling, calls=[]):
    calls.append(0)
    if len(calls) == 8 + 3:
        time.sleep_ms(700)
    return convert(self, oversampling)
board.OwnAdc.convert = slow
"""
"""After the eight conversions by which a board measures itself, the third takes longer than 7 readings at 10 Hz."""
ONE_FAILS = """
import board
def failing(self, message, obey=board.Board._obey):
    if message[0] == board.IDENTIFY:
        raise ValueError("an error of the program")
    obey(self, message)
board.Board._obey = failing
"""
WITHIN_S = 60.0
RESET = 3
"""What the played `machine.reset` ends with."""


def run_board(code: str, **names: str) -> list[str]:
    """Return the lines that a program prints which uses the board's, with these names in the environment."""
    done = subprocess.run(
        [micropython(), "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env=os.environ | {"MICROPYPATH": f"{BOARDS}:{PARTS}"} | names,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def ask_codec(lines: Sequence[str]) -> list[str]:
    """Return what the codec answers to each line."""
    command, paths = [micropython(), "-c", CODEC], {"MICROPYPATH": f"{BOARDS}:{PARTS}"}
    given = "".join(f"{line}\n" for line in lines)
    done = subprocess.run(
        command, input=given, capture_output=True, text=True, timeout=120, check=False, env=os.environ | paths
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def heard(stream: bytes) -> str:
    """Return the messages to a device in a stream, as the Python codec decodes them."""
    messages = [message for message in Decoder().feed(stream) if message.TYPE < 0x80]
    return ",".join(" ".join(map(str, (message.TYPE, *astuple(message)))) for message in messages)


def test_golden_messages_and_their_frames_are_one() -> None:
    assert ask_codec([f"encode {vector['body_hex']}" for vector in GOLDEN["vectors"]]) == [
        vector["frame_hex"] for vector in GOLDEN["vectors"]
    ]
    frames = [encode(golden_message(vector)) for vector in GOLDEN["vectors"]]
    decoded = ask_codec([f"decode {frame.hex()}" for frame in frames])
    assert decoded == [heard(frame) for frame in frames]
    assert len(list(filter(None, decoded))) > 5


def test_damaged_golden_frames_are_rejected_and_the_next_frame_is_taken() -> None:
    frames = [bytes.fromhex(rejected["frame_hex"]) + encode(Stop()) for rejected in GOLDEN["rejected"]]
    assert ask_codec([f"decode {frame.hex()}" for frame in frames]) == [str(Stop.TYPE)] * len(frames)


def test_damaged_streams_and_noise_give_what_the_other_codec_finds_in_them() -> None:
    chance = random.Random(4)  # noqa: S311 - test data, not secrets
    streams = []
    for _ in range(100):
        stream = bytearray(b"".join(encode(random_message(chance)) for _ in range(10)))
        damage(chance, stream, 3)
        streams.append(bytes(stream) + encode(Ping(chance.randrange(65536))))
    streams += [noise(chance, 2000, part) + encode(Stop()) for part in (0.01, 0.1, 0.5)]
    decoded = ask_codec([f"decode {stream.hex()}" for stream in streams])
    assert decoded == [heard(stream) for stream in streams]
    assert sum(text.count(",") for text in decoded) > 200


class Host:
    """The other end of the line."""

    def __init__(self, line: int) -> None:
        self._line = line
        self._decoder = Decoder()
        self.messages: list[Message] = []
        """All that arrived."""

    def send(self, *what: Message | bytes) -> None:
        os.write(self._line, b"".join(one if isinstance(one, bytes) else encode(one) for one in what))

    def hear(self, is_enough: Callable[[], bool]) -> None:
        """Listen until it is enough."""
        deadline_s = monotonic() + WITHIN_S
        while not is_enough():
            assert select.select([self._line], [], [], max(0.0, deadline_s - monotonic()))[0], self.messages[-3:]
            self.messages += self._decoder.feed(os.read(self._line, 4096))

    def ask(self, token: int) -> Pong:
        """Return the answer to a ping: the board has obeyed what it was sent before."""
        self.send(Ping(token))
        self.hear(lambda: any(isinstance(message, Pong) and message.token == token for message in self.messages))
        return next(m for m in reversed(self.messages) if isinstance(m, Pong))

    @property
    def readings(self) -> list[Reading]:
        return [message for message in self.messages if isinstance(message, Reading)]

    @property
    def rejected(self) -> int:
        return self._decoder.counts.rejected


@contextmanager
def host(folder: Path, wiring: str, volts: Sequence[float]) -> Iterator[Host]:
    """The host of a board that has said hello."""
    with plugged_in(folder, wiring, volts) as board:
        line = Host(board.host_end)
        line.hear(lambda: bool(line.messages))
        yield line


@pytest.mark.parametrize(
    ("wiring", "volts", "bits", "counts"),
    [
        (OWN_ADC, [0.0, 1.65, 3.3], 12, (0, 2048, 4095)),
        (ONE_CHIP, [0.0, 1.024, 2.048, 4.0], 15, (0, 8192, 16384, 32000)),
    ],
)
def test_readings_are_sums_of_the_voltages_in_order_with_the_time(
    tmp_path: Path, wiring: str, volts: list[float], bits: int, counts: tuple[int, ...]
) -> None:
    with host(tmp_path, wiring, volts) as line:
        (hello,) = line.messages
        assert isinstance(hello, Hello)
        assert hello.is_compatible
        assert (hello.channel_count, hello.adc_bits) == (len(volts), bits)
        before = line.ask(0x0303)  # with what would be a Ctrl-C
        line.send(Start(10, 2))
        line.hear(lambda: len(line.readings) >= 5)
        after = line.ask(7)
        assert {reading.counts for reading in line.readings} == {tuple(2 * count for count in counts)}
        assert {reading.oversampling for reading in line.readings} == {2}
        times = [before.device_us, *(reading.device_us for reading in line.readings), after.device_us]
        assert times == sorted(times)
        # A reading that a busy machine did not take has its number, so numbers tell the time.
        for one, next_ in pairwise(line.readings):
            number = next_.sequence - one.sequence
            assert number >= 1
            assert next_.device_us - one.device_us == pytest.approx(100_000 * number, abs=99_000)
        assert line.rejected == 0


def test_a_session_stops_begins_anew_and_ignores_what_the_board_cannot_keep(tmp_path: Path) -> None:
    with host(tmp_path, ONE_CHIP, [1.0] * 4) as line:
        (hello,) = line.messages
        assert isinstance(hello, Hello)
        refused = [Start(0, 1), Start(hello.max_rate_hz + 1, 1), Start(10, 0), Start(10, 3)]
        line.send(*refused, b"\0\x05\x01garbage\0", HelloRequest())
        line.ask(1)
        assert line.messages == [hello, hello, line.messages[-1]]
        line.send(Start(10, 1))
        line.hear(lambda: len(line.readings) >= 2)
        line.send(*refused)
        line.hear(lambda: len(line.readings) >= 4)
        assert {reading.oversampling for reading in line.readings} == {1}
        line.send(Stop())
        line.ask(2)
        last = line.readings[-1].sequence
        line.send(Start(10, 2))
        line.hear(lambda: line.readings[-1].oversampling == 2)
        assert next(one for one in line.readings if one.oversampling == 2).sequence == last + 1


@pytest.mark.promise(
    "docs/how-to/micropython-board.md",
    "its channels read 0, which the daemon takes for a missing cable; the others go on",
)
def test_channels_of_a_chip_that_does_not_answer_are_zero_until_it_does(tmp_path: Path) -> None:
    with plugged_in(tmp_path, TWO_CHIPS, [1.024] * 8) as board:
        line = Host(board.host_end)
        line.send(Start(5, 1))
        line.hear(lambda: bool(line.readings))
        assert line.readings[-1].counts == (8192,) * 8
        board.put([1.024] * 4 + [-1.0] * 4)
        line.hear(lambda: line.readings[-1].counts == (8192,) * 4 + (0,) * 4)
        board.put([2.048] * 8)
        line.hear(lambda: line.readings[-1].counts == (16384,) * 8)


def test_identify_blinks_until_its_time_or_zero(tmp_path: Path) -> None:
    with plugged_in(tmp_path, OWN_ADC, [1.0] * 3) as board:
        line = Host(board.host_end)
        line.send(Identify(255))
        wait_until(lambda: len(board.light.read_text().split()) >= 3)
        line.send(Identify(0))
        line.ask(2)
        line.ask(3)
        assert board.light.read_text().split()[-1] == "0"


@pytest.mark.promise(
    "docs/how-to/micropython-board.md",
    "the program ends when mpremote asks for the prompt",
)
def test_the_interrupt_of_mpremote_ends_the_program_even_in_a_stream(tmp_path: Path) -> None:
    with plugged_in(tmp_path, OWN_ADC, [1.0] * 3) as board:
        line = Host(board.host_end)
        line.send(Start(10, 1))
        line.hear(lambda: bool(line.readings))
        line.send(b"\0\r\x03")
        assert board.process.wait(WITHIN_S) == 0


def test_of_a_chip_that_drops_out_in_the_middle_of_a_reading_no_part_is_left(tmp_path: Path) -> None:
    (tmp_path / "volts").write_text(" ".join(["1.024"] * 8))
    lines = run_board(DROP_OUT, VOLTAGES=str(tmp_path / "volts"))
    assert lines == [" ".join(["16384"] * 4 + ["0"] * 4), " ".join(["16384"] * 8)]


def test_a_chip_that_never_finishes_is_one_that_does_not_answer(tmp_path: Path) -> None:
    (tmp_path / "volts").write_text(" ".join(["1.024"] * 8))
    assert run_board(HANGING, VOLTAGES=str(tmp_path / "volts")) == [" ".join(["0"] * 4 + ["8192"] * 4)]


def test_the_clock_goes_on_where_the_ticks_of_a_board_wrap() -> None:
    assert run_board(TICKS) == [str(400_000_000 * number) for number in range(1, 13)]


@pytest.mark.promise(
    "docs/how-to/micropython-board.md",
    "it measures at each start how fast it is, and states 80 % of that.",
    "Converters limit it to 125 readings per second whatever their number",
)
def test_a_board_states_four_fifths_of_its_own_pace_and_no_more_than_its_line_carries() -> None:
    # 10 ms a reading; 4 x 1.6 ms, twice; 90 % of 11 520 bytes a second for 46 bytes a reading; one in 2 s.
    assert run_board(PACE) == ["80", "125", "125", "225", "1"]


@pytest.mark.promise(
    "docs/how-to/micropython-board.md",
    "readings that it could not take have their numbers, so the daemon counts them as lost",
)
def test_readings_for_which_a_board_had_no_time_have_their_numbers(tmp_path: Path) -> None:
    with host(tmp_path, ONE_TAKES_LONG + OWN_ADC, [1.0] * 3) as line:
        line.send(Start(10, 1))
        line.hear(lambda: len(line.readings) >= 4)
        before, late = line.readings[1], line.readings[3]
        missing = late.sequence - before.sequence - 2
        assert missing >= 3  # six, unless the machine held up the reading before
        assert late.device_us - before.device_us > 100_000 * missing


@pytest.mark.promise("docs/how-to/micropython-board.md", "the board restarts, and the daemon begins a new session")
def test_an_error_in_the_program_resets_the_board(tmp_path: Path) -> None:
    with plugged_in(tmp_path, ONE_FAILS + OWN_ADC, [1.0] * 3) as board:
        Host(board.host_end).send(Identify(1))
        assert board.process.wait(WITHIN_S) == RESET
