"""Loads and faults that a person puts on the virtual surface, a line of standard input each."""

import math
import sys
import threading
from collections.abc import Callable

from beamtouch_common.typed import typed_line
from beamtouch_models.rig.faults import FORMS, REPLIES, SENSORS, Faults
from beamtouch_models.rig.script import Load

NOTHING = Load(None, 0.0)
MEND = "mend"


class ByHand:
    """The load of the last line touches the surface. An empty line lifts it. Faults stay until `mend`."""

    def __init__(self, length_mm: float, faults: Faults) -> None:
        self._length_mm, self._faults = length_mm, faults
        self._load = NOTHING
        self._clock: Callable[[], float] = lambda: 0.0

    def follow(self, clock: Callable[[], float]) -> None:
        """Begin to take lines from standard input, and say on standard output what each has done.

        `clock` returns the time since the start [s].
        """
        self._clock = clock
        # A thread, as standard input may be a terminal, a pipe or a file, and only a blocking read serves all three.
        threading.Thread(target=self._read, daemon=True).start()

    def at(self, _seconds: float) -> Load:
        """Load that is on now."""
        return self._load

    def _read(self) -> None:
        while line := typed_line():
            try:
                print(self._take(line), flush=True)
            except ValueError as error:
                print(f"beamtouch-rig: {error}", file=sys.stderr, flush=True)

    def _take(self, line: str) -> str:
        text = line.strip()
        if text == MEND:
            self._faults.mend()
            return "no fault is on"
        if text[:1].isalpha() and text.split(":")[0] in (*SENSORS, *REPLIES):
            self._faults.add(text, self._clock())
            return f"{text} is on"
        self._load = load_of(line, self._length_mm)
        position_mm, force_n = self._load
        return "nothing is on" if position_mm is None else f"{force_n:g} N at {position_mm:g} mm is on"


def load_of(line: str, length_mm: float) -> Load:
    """Read a position and a force, or nothing; raises ValueError with the reason in one line."""
    words = line.split()
    if not words:
        return NOTHING
    try:
        position_mm, force_n = map(float, words)
    except ValueError:
        message = (
            "give a position in mm and a force in N, as in 150 10, or an empty line to lift the load; "
            f"or a fault, {FORMS}, or {MEND} to end all faults"
        )
        raise ValueError(message) from None
    if not (0 <= position_mm <= length_mm and 0 <= force_n < math.inf):
        message = f"{force_n:g} N at {position_mm:g} mm is no load on a beam of {length_mm:g} mm"
        raise ValueError(message)
    return Load(position_mm, force_n)
