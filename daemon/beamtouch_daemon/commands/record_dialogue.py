"""The person's side of `record`: what is asked, and what the answers mean.

On a terminal a wrong answer is asked for again. Anywhere else nobody would see the question, so it ends the recording.
"""

import asyncio
import math
import sys
import threading
from dataclasses import replace

from beamtouch_daemon.commands.record import LoadRefusedError, TakeBack, require_stated
from beamtouch_daemon.commands.record_table import Load
from beamtouch_daemon.config import settings as config

ACCEPT, UNDO = "accept", "undo"
"""Words of the dialogue: record all the same, and take back the last load."""
HELP = f"""\
Put a load on the beam, then answer. Besides the answers that are asked for:
  {UNDO:7} takes back the last load
  {ACCEPT:7} after a load, or alone where the load is given: records it whatever speaks against it"""


class Dialogue:
    """Asks for loads, one line each, or for a sign that a given load is on."""

    def __init__(self, given: list[Load] | None, known: config.Loads | None) -> None:
        self.missing: set[Load] = set()
        """Loads that were refused and not recorded since."""
        self._given = given
        self._done = 0
        """How many of the given loads had their turn."""
        self._known = known
        self._is_terminal = sys.stdin.isatty()
        self._lines: asyncio.Queue[str] = asyncio.Queue()
        self._loop = asyncio.get_running_loop()
        # A thread, as standard input may be a terminal, a pipe or a file, and only a blocking read serves all three.
        threading.Thread(target=self._read, daemon=True).start()

    async def next_load(self, number: int) -> Load | TakeBack | None:
        """Return the next load once it is on the beam; None at the end.

        Raises
        ------
        ConfigError
            A wrong answer that does not come from a terminal.
        """
        while self._given is None or self._done < len(self._given):
            line = await self._ask(self._question(number))
            if line is None or (self._given is None and not line.strip()):
                return None
            try:
                return self._answer(line.split())
            except (ValueError, LoadRefusedError) as error:
                if not self._is_terminal:
                    message = f"standard input: {line.strip()!r}: {error}; {number - 1} loads are recorded"
                    raise config.ConfigError(message) from None
                self.say(str(error))
        return None

    def recorded(self, load: Load, text: str) -> None:
        """Say that a load was recorded."""
        self.missing.discard(replace(load, is_accepted=False))
        self.say(text)

    def refused(self, load: Load, reason: str) -> None:
        """Say that a load was not recorded; on a terminal one that was given is asked for again."""
        self.missing.add(load)
        self.say(f"{load} left out: {reason}; put it on again, or answer with {ACCEPT} to record it all the same")
        if self._given is not None and self._is_terminal:
            self._done -= 1

    def say(self, text: str) -> None:
        """Print a line to the person."""
        print(text, file=sys.stderr, flush=True)

    def _question(self, number: int) -> str:
        if self._given is None:
            return f"load {number}: put it on; position in mm and force in N (empty line: done; {UNDO}): "
        return f"load {number}: put {self._given[self._done]} on, then press Enter ({UNDO}): "

    def _answer(self, words: list[str]) -> Load | TakeBack:
        if words == [UNDO]:
            self._done = max(0, self._done - 1)
            return TakeBack()
        if self._given is None:
            load = load_of(words)
            require_stated(load, self._known)
            return load
        if words not in ([], [ACCEPT]):
            message = f"press Enter once the load is on, or type {UNDO} or {ACCEPT}"
            raise ValueError(message)
        load = self._given[self._done]
        self._done += 1
        return replace(load, is_accepted=load.is_accepted or bool(words))

    async def _ask(self, question: str) -> str | None:
        print(question, end="", file=sys.stderr, flush=True)
        line = await self._lines.get()
        if not self._is_terminal:
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
    """Read a position and a force, and perhaps that they are accepted; ValueError says what is wrong in one line."""
    is_accepted = words[2:] == [ACCEPT]
    try:
        position, force = (float(word.replace(",", ".")) for word in (words[:2] if is_accepted else words))
    except ValueError:
        message = "give two numbers: the position in mm from the left end, and the force in N, as in 150 10"
        raise ValueError(message) from None
    if not 0 <= position < math.inf:
        message = f"a position of {position:g} mm is not on the beam; count from its left end"
        raise ValueError(message)
    if not 0 < force < math.inf:
        message = f"a force of {force:g} N is no load; give newtons (1 kg weighs 9.81 N)"
        raise ValueError(message)
    return Load(position, force, is_accepted)
