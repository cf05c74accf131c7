"""The person's side of `record`: what is asked, and what the answers mean."""

import asyncio
import math
import sys
import threading
from collections.abc import Iterator

from beamtouch_daemon.record import Load


class Dialogue:
    """Asks for loads, one line each, or for a sign that a given load is on."""

    def __init__(self, given: list[Load] | None) -> None:
        self._given: Iterator[Load] | None = None if given is None else iter(given)
        self._lines: asyncio.Queue[str] = asyncio.Queue()
        self._loop = asyncio.get_running_loop()
        # A thread, as standard input may be a terminal, a pipe or a file, and only a blocking read serves all three.
        threading.Thread(target=self._read, daemon=True).start()

    async def next_load(self, number: int) -> Load | None:
        """Return the next load once it is on the beam; None at the end."""
        if self._given is not None:
            load = next(self._given, None)
            if load is None:
                return None
            line = await self._ask(
                f"load {number}: put {load.force_n:g} N at {load.position_mm:g} mm, then press Enter: "
            )
            return None if line is None else load
        while True:
            line = await self._ask(f"load {number}: put it on; position in mm and force in N (empty line: done): ")
            if line is None or not line.strip():
                return None
            try:
                return load_of(line.split())
            except ValueError as error:
                say(str(error))

    async def _ask(self, question: str) -> str | None:
        print(question, end="", file=sys.stderr, flush=True)
        line = await self._lines.get()
        if not sys.stdin.isatty():
            print(file=sys.stderr)
        return line or None

    def _read(self) -> None:
        line = "begin"
        while line:
            line = sys.stdin.readline()
            try:
                self._loop.call_soon_threadsafe(self._lines.put_nowait, line)
            except RuntimeError:  # the loop has ended, so nobody waits
                return


def load_of(words: list[str]) -> Load:
    """Read a position and a force; ValueError says what is wrong in one line."""
    try:
        position, force = (float(word.replace(",", ".")) for word in words)
    except ValueError:
        message = "give two numbers: the position in mm from the left end, and the force in N, as in 150 10"
        raise ValueError(message) from None
    if not 0 <= position < math.inf:
        message = f"a position of {position:g} mm is not on the beam; count from its left end"
        raise ValueError(message)
    if not 0 < force < math.inf:
        message = f"a force of {force:g} N is no load; give newtons (1 kg weighs 9.81 N)"
        raise ValueError(message)
    return Load(position, force)


def say(text: str) -> None:
    """Print a line to the person."""
    print(text, file=sys.stderr, flush=True)
