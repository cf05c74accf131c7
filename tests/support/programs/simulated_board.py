"""The reference firmware on the simulated board: recordings in simulated time, however busy the machine is."""

import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Hello, Message, Pong, Reading
from beamtouch_protocol.sequence import missing_between
from support.programs.toolchain import FIRMWARE_PROTOCOL, need, run
from support.running.debian_parts import give_up

MILLIVOLTS = 5000
TIMEOUT_S = 120


def build_board(folder: Path) -> None:
    """Build the simulated board."""
    need("gcc", "make", "pkg-config")
    if subprocess.run(["pkg-config", "--exists", "simavr", "libelf"], check=False).returncode != 0:
        give_up("libsimavr-dev or libelf-dev not installed")
    run("make", "-C", FIRMWARE_PROTOCOL / "simulator", f"BUILD={folder}", "CC=gcc")


def build_firmware(folder: Path, channels: int, more: str = "") -> None:
    """Build the firmware for a number of channels."""
    need("make", "avr-gcc")
    run("make", "-C", FIRMWARE_PROTOCOL / "avr", f"BUILD={folder}", f"CHANNELS={channels}", f"MORE={more}")


def count_of(millivolts: int) -> int:
    """Return what a conversion of a voltage gives."""
    return min(millivolts * 1023 // MILLIVOLTS, 1023)


def at(seconds: float, what: Message | bytes | Sequence[int] | str) -> str:
    """Return a line of the board's script: a message or bytes to send, voltages in millivolts, or another command."""
    if isinstance(what, str):
        return f"@{seconds} {what}\n"
    if isinstance(what, bytes):
        return f"@{seconds} send {what.hex()}\n"
    if isinstance(what, Message):
        return at(seconds, encode(what))
    return f"@{seconds} {' '.join(map(str, what))}\n"


@dataclass(frozen=True)
class Recording:
    """What a device sent while the board ran, and what the board says of it."""

    messages: list[Message]
    rejected: int
    report: dict[str, int]

    @property
    def readings(self) -> list[Reading]:
        return [message for message in self.messages if isinstance(message, Reading)]

    @property
    def hellos(self) -> list[Hello]:
        return [message for message in self.messages if isinstance(message, Hello)]

    @property
    def pongs(self) -> list[Pong]:
        return [message for message in self.messages if isinstance(message, Pong)]

    @property
    def lost(self) -> int:
        """Readings that have taken a number and did not arrive."""
        numbers = [reading.sequence for reading in self.readings]
        return sum(missing_between(*pair) for pair in pairwise(numbers))

    @property
    def steps_us(self) -> list[int]:
        """Device time from each reading to the next."""
        times = [reading.device_us for reading in self.readings]
        return [(after - before) % 2**32 for before, after in pairwise(times)]


@dataclass(frozen=True)
class Board:
    """The board program with a firmware."""

    program: Path
    firmware: Path

    @property
    def command(self) -> list[str]:
        return [str(self.program), str(self.firmware)]

    def record(self, scratch: Path, seconds: float, *script: str, options: Sequence[str | Path] = ()) -> Recording:
        """Run for some simulated seconds; `script` are lines from `at`, in the order of their times."""
        output = scratch / "line.bin"
        command = [*self.command, "--seconds", str(seconds), "--output", str(output), *map(str, options)]
        done = subprocess.run(
            command, input="".join(script), capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
        assert done.returncode == 0, done.stderr
        decoder = Decoder()
        messages = decoder.feed(output.read_bytes())
        report = {name: int(number) for name, number in map(str.split, done.stdout.splitlines())}
        return Recording(messages, decoder.counts.rejected, report)


Boards = Callable[..., Board]
"""From a number of channels, and more definitions for the compiler, to a board with a firmware for them."""
