"""The dialogue of `record`: its questions and the meaning of the answers.

On a terminal, a wrong answer repeats the question. Without a terminal nobody would see the question, so a wrong answer
ends the recording.
"""

import asyncio
import math
import sys
import threading
from dataclasses import replace

from beamtouch_common.errors import InputError
from beamtouch_common.typed import is_terminal, typed_line
from beamtouch_daemon.commands.load_recorder import LoadRefusedError, require_stated
from beamtouch_daemon.commands.record_table import Load
from beamtouch_daemon.config.settings import Loads

ACCEPT, UNDO = "accept", "undo"
"""Words of the dialogue: record a load without checks, and remove the last load."""
HELP = f"""\
Put a load on the beam, then answer. Two more answers are possible:
  {UNDO:7} removes the last load. The recording ends with the last load of --at; to replace that one, record it again
          with --append and without --at
  {ACCEPT:7} after a load (or alone, with --at) records it without checks"""


class Undo:
    """The answer that removes the last load."""


class Dialogue:
    """Asks for a load, one line each, or for Enter once a given load is on the beam."""

    def __init__(self, given: list[Load] | None, known: Loads | None) -> None:
        self._given = given
        self._next = 0
        """Index of the given load whose turn is next."""
        self._on = 0
        """Index of the given load that is on the beam."""
        self._recorded: list[int] = []
        """Indices of the given loads that are recorded, in the order of recording."""
        self._not_recorded: set[int | Load] = set()
        """The loads of `not_recorded`: given loads by index, others by value."""
        self._known = known
        self._is_terminal = is_terminal()
        self._lines: asyncio.Queue[str] = asyncio.Queue()
        self._loop = asyncio.get_running_loop()
        # Standard input may be a terminal, a pipe or a file. Only a blocking read, in a thread, works for all three.
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def not_recorded(self) -> list[Load]:
        """Loads that were refused or removed and have not been recorded since."""
        return [(self._given or [])[load] if isinstance(load, int) else load for load in self._not_recorded]

    async def next_load(self, number: int) -> Load | Undo | None:
        """Return the next load once it is on the beam; None at the end.

        Raises
        ------
        InputError
            A wrong answer, without a terminal.
        """
        while self._given is None or self._next < len(self._given):
            line = await self._ask(self._question(number))
            if line is None or (self._given is None and not line.strip()):
                return None
            try:
                return self._answer(line.split())
            except (ValueError, LoadRefusedError) as error:
                if not self._is_terminal:
                    message = f"standard input: {line.strip()!r}: {error}; {number - 1} loads are recorded"
                    raise InputError(message) from None
                self.say(str(error))
        return None

    def recorded(self, load: Load, text: str) -> None:
        """Say that a load was recorded."""
        self._not_recorded.discard(self._key(load))
        if self._given is not None:
            self._recorded.append(self._on)
        self.say(text)

    def refused(self, load: Load, reason: str) -> None:
        """Say that a load was not recorded; on a terminal, ask for a given load again."""
        self._not_recorded.add(self._key(load))
        self.say(f"{load} not recorded: {reason}; put it on again, or answer {ACCEPT} to record it without checks")
        if self._given is not None and self._is_terminal:
            self._next = self._on

    def say(self, text: str) -> None:
        """Print a line."""
        print(text, file=sys.stderr, flush=True)

    def _question(self, number: int) -> str:
        if self._given is None:
            return f"load {number}: put it on, then enter position in mm and force in N (empty line: done; {UNDO}): "
        return f"load {number}: put {self._given[self._next]} on, then press Enter ({UNDO}): "

    def _answer(self, words: list[str]) -> Load | Undo:
        if words == [UNDO]:
            if self._recorded:
                self._next = self._recorded.pop()
                self._not_recorded.add(self._next)
            return Undo()
        if self._given is None:
            load = load_of(words)
            require_stated(load, self._known)
            return load
        if words not in ([], [ACCEPT]):
            message = f"press Enter once the load is on, or type {UNDO} or {ACCEPT}"
            raise ValueError(message)
        load = self._given[self._next]
        self._on, self._next = self._next, self._next + 1
        return replace(load, is_accepted=load.is_accepted or bool(words))

    def _key(self, load: Load) -> int | Load:
        return replace(load, is_accepted=False) if self._given is None else self._on

    async def _ask(self, question: str) -> str | None:
        print(question, end="", file=sys.stderr, flush=True)
        line = await self._lines.get()
        if not self._is_terminal:
            print(file=sys.stderr)
        return line or None

    def _read(self) -> None:
        line = "begin"
        while line:
            line = typed_line()
            try:
                self._loop.call_soon_threadsafe(self._lines.put_nowait, line)
            except RuntimeError:  # the loop has ended
                return


def load_of(words: list[str]) -> Load:
    """Return the load that the words state: position, force, and perhaps ACCEPT; ValueError with one line if wrong."""
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
