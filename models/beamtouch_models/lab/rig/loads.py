"""Loads on the virtual surface: a script that touches, moves and lifts, or a person who types."""

import math
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple, Self

from pydantic import Field, model_validator

from beamtouch_common.files import load_toml
from beamtouch_common.typed import typed_line
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.tables import Finite, Pair, PositiveFinite, Strict
from beamtouch_models.errors import SceneError
from beamtouch_models.lab.rig.faults import FORMS, REPLIES, SENSORS, Faults

MEND = "mend"

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Load(NamedTuple):
    """The load at one instant; its position is None if nothing touches."""

    position_mm: float | None
    force_n: float


NOTHING = Load(None, 0.0)


class Step(Strict):
    """One step of a script: no load without a position, a resting load with one position, a moving load with two."""

    seconds: PositiveFinite
    """Length of the step."""
    position_mm: Finite | Pair | None = None
    """Place of the load, or places at the start and the end of the step. Without it, nothing touches."""
    force_n: NotNegative | Annotated[tuple[NotNegative, NotNegative], Field(strict=False)] | None = None
    """Force of the load, or forces at the start and the end of the step."""

    @model_validator(mode="after")
    def _both_or_neither(self) -> Self:
        if (self.position_mm is None) != (self.force_n is None):
            raise ValueError("give position_mm and force_n together, or neither for no load")
        return self

    def at(self, fraction: float) -> Load:
        """Return the load at a fraction 0..1 of the step."""
        if self.position_mm is None or self.force_n is None:
            return NOTHING
        return Load(_between(self.position_mm, fraction), _between(self.force_n, fraction))


class Script(Strict):
    """A sequence of steps. After the last it starts again if `repeat`, else the load is gone for good."""

    repeat: bool = True
    """True if the script starts again after its last step."""
    step: Annotated[list[Step], Field(min_length=1)]
    """Steps, in their order."""

    def at(self, seconds: float) -> Load:
        """Return the load at a time [s] since the start."""
        total = sum(step.seconds for step in self.step)
        if seconds >= total and not self.repeat:
            return NOTHING
        rest = seconds % total
        for step in self.step:
            if rest < step.seconds:
                return step.at(rest / step.seconds)
            rest -= step.seconds
        return self.step[-1].at(1.0)


def _between(ends: float | tuple[float, float], fraction: float) -> float:
    if not isinstance(ends, tuple):
        return ends
    return ends[0] + fraction * (ends[1] - ends[0])


def load_script(path: Path, length_mm: float) -> Script:
    """Read a script file for a beam of `length_mm`; raises InputError with the reason if it is wrong."""
    script = load_toml(Script, path)
    for number, step in enumerate(script.step, start=1):
        ends = step.position_mm if isinstance(step.position_mm, tuple) else (step.position_mm,)
        if any(end is not None and not 0 <= end <= length_mm for end in ends):
            raise SceneError(f"{path}: step {number}: position_mm must lie on the beam, 0..{length_mm:g} mm")
    return script


def default_script(scene: Scene) -> Script:
    """Return a script of about 20 s that touches, rests, moves and lifts over the whole range of a scene."""
    low, high = scene.contact.position_mm
    weak, strong = scene.contact.force_range_n
    middle = (weak + strong) / 2

    def at(fraction: float) -> float:
        return low + fraction * (high - low)

    return Script(
        step=[
            Step(seconds=1.0),
            Step(seconds=2.0, position_mm=at(0.25), force_n=middle),
            Step(seconds=3.0, position_mm=(at(0.25), at(0.75)), force_n=middle),
            Step(seconds=1.5, position_mm=at(0.75), force_n=middle),
            Step(seconds=1.0),
            Step(seconds=2.0, position_mm=at(0.5), force_n=strong),
            Step(seconds=3.0, position_mm=(at(0.5), at(0.2)), force_n=(strong, middle)),
            Step(seconds=1.0),
            Step(seconds=1.5, position_mm=at(0.4), force_n=(weak + middle) / 2),
            Step(seconds=2.5, position_mm=(at(0.4), at(0.8)), force_n=(middle, strong)),
        ]
    )


class ByHand:
    """The load of the last line touches the surface. An empty line lifts it. Faults stay until `mend`."""

    def __init__(self, length_mm: float, faults: Faults) -> None:
        self._length_mm, self._faults = length_mm, faults
        self._load = NOTHING

    def follow(self, clock: Callable[[], float]) -> None:
        """Begin to take lines from standard input, and say on standard output what each has done.

        `clock` returns the time since the start [s].
        """
        # A thread, as standard input may be a terminal, a pipe or a file, and only a blocking read serves all three.
        threading.Thread(target=self._read, args=(clock,), daemon=True).start()

    def at(self, _seconds: float) -> Load:
        """Load that is on now."""
        return self._load

    def _read(self, clock: Callable[[], float]) -> None:
        while line := typed_line():
            try:
                print(self._take(line.strip(), clock()), flush=True)
            except ValueError as error:
                print(f"beamtouch-rig: {error}", file=sys.stderr, flush=True)

    def _take(self, line: str, seconds: float) -> str:
        if line == MEND:
            self._faults.mend()
            return "no fault is on"
        if line.split(":", maxsplit=1)[0] in (*SENSORS, *REPLIES):
            self._faults.add(line, seconds)
            return f"{line} is on"
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
        raise ValueError(f"{force_n:g} N at {position_mm:g} mm is no load on a beam of {length_mm:g} mm")
    return Load(position_mm, force_n)
