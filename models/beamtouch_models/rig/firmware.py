"""The reference firmware on the simulated board (`firmware_protocol/simulator`), as the device of a virtual surface."""

import asyncio
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from beamtouch_models.errors import SceneError
from beamtouch_models.rig.pty_line import remove_left_behind

ADC_BITS = 10
SUPPLY_MV = 5000
_UPDATE_S = 0.002


@dataclass(frozen=True)
class Firmware:
    """The board program and the firmware image that it runs."""

    board: Path
    elf: Path


class FirmwareDevice:
    """A running board, whose firmware serves the surface."""

    def __init__(self, process: Process) -> None:
        self._process = process

    @classmethod
    async def started(cls, firmware: Firmware, line: Path) -> "FirmwareDevice":
        """Start the board with its serial line at `line`.

        Raises
        ------
        SceneError
            The board does not start; it has printed the reason.
        OSError
            The board is not an executable file.
        """
        remove_left_behind(line)
        command = (str(firmware.board), str(firmware.elf), "--link", str(line))
        process = await asyncio.create_subprocess_exec(*command, stdin=PIPE, stdout=PIPE)
        if process.stdout is None or not await process.stdout.readline():
            if process.stdin is not None:
                process.stdin.close()
            await process.wait()  # the board has closed its output, so it is about to end
            message = f"the simulated board {firmware.board} did not start"
            raise SceneError(message)
        return cls(process)

    async def serve(self, outputs: Callable[[], Sequence[float]]) -> None:
        """Set the voltages to the sensor outputs, 0 to 1, until cancelled; SceneError if the board ends."""
        voltages = self._process.stdin
        if voltages is None:
            message = "the board has no standard input"
            raise AssertionError(message)
        try:
            while not voltages.is_closing():
                voltages.write((" ".join(map(_millivolts, outputs())) + "\n").encode())
                await voltages.drain()
                await asyncio.sleep(_UPDATE_S)
        except (BrokenPipeError, ConnectionResetError):
            pass
        finally:
            with suppress(BrokenPipeError, ConnectionResetError):
                voltages.close()  # this ends the board
            await self._process.wait()
        message = "the simulated board ended unexpectedly"
        raise SceneError(message)


def _millivolts(output: float) -> str:
    """Return the voltage of an output, half a count higher: the chip's ADC rounds down, the rig's to the nearest."""
    full_scale = 2**ADC_BITS - 1
    return str(round(min((output * full_scale + 0.5) / full_scale, 1.0) * SUPPLY_MV))
