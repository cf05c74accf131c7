"""Loads that a person puts on the virtual surface, a line of standard input each."""

import math
import sys
import threading

from beamtouch_common.typed import typed_line
from beamtouch_models.rig.script import Load

NOTHING = Load(None, 0.0)


class ByHand:
    """The load of the last line touches the surface. An empty line lifts it."""

    def __init__(self, length_mm: float) -> None:
        self._length_mm = length_mm
        self._load = NOTHING

    def follow(self) -> None:
        """Begin to take loads from standard input, and say each on standard output once it is on."""
        # A thread, as standard input may be a terminal, a pipe or a file, and only a blocking read serves all three.
        threading.Thread(target=self._read, daemon=True).start()

    def at(self, _seconds: float) -> Load:
        """Load that is on now."""
        return self._load

    def _read(self) -> None:
        while line := typed_line():
            try:
                self._load = load_of(line, self._length_mm)
            except ValueError as error:
                print(f"beamtouch-rig: {error}", file=sys.stderr, flush=True)
                continue
            position_mm, force_n = self._load
            print("nothing is on" if position_mm is None else f"{force_n:g} N at {position_mm:g} mm is on", flush=True)


def load_of(line: str, length_mm: float) -> Load:
    """Read a position and a force, or nothing; raises ValueError with the reason in one line."""
    words = line.split()
    if not words:
        return NOTHING
    try:
        position_mm, force_n = map(float, words)
    except ValueError:
        message = "give a position in mm and a force in N, as in 150 10, or an empty line to lift the load"
        raise ValueError(message) from None
    if not (0 <= position_mm <= length_mm and 0 <= force_n < math.inf):
        message = f"{force_n:g} N at {position_mm:g} mm is no load on a beam of {length_mm:g} mm"
        raise ValueError(message)
    return Load(position_mm, force_n)
