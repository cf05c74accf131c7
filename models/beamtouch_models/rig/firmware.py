"""The reference firmware on the simulated board (`firmware_protocol/simulator`), as the device of a virtual surface."""

import asyncio
from asyncio.subprocess import PIPE
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from pathlib import Path

from beamtouch_models.errors import SceneError
from beamtouch_models.rig.lines import remove_left_behind

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
    voltages, announced = process.stdin, process.stdout
    if voltages is None or announced is None:
        raise AssertionError("the board has no standard input and output")
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
        except (BrokenPipeError, ConnectionResetError):
            pass
        finally:
            with suppress(BrokenPipeError, ConnectionResetError):
                voltages.close()  # this ends the board
            await process.wait()
        raise SceneError("the simulated board ended unexpectedly")

    return serve()


def _millivolts(output: float) -> str:
    """Return the voltage of an output, half a count higher: the chip's ADC rounds down, the rig's to the nearest."""
    full_scale = 2**ADC_BITS - 1
    return str(round(min((output * full_scale + 0.5) / full_scale, 1.0) * SUPPLY_MV))
