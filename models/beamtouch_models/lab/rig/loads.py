"""Loads on the virtual surface: a script that touches, moves and lifts, or a person who types."""

import math
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple, Self

from pydantic import Field, model_validator

from beamtouch_common.files import load_toml
from beamtouch_common.outline import BEAM_AXES, PLATE_AXES, Outline, axes_of
from beamtouch_common.typed import typed_line
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.tables import Finite, Pair, PositiveFinite, Strict
from beamtouch_models.errors import SceneError
from beamtouch_models.lab.rig.faults import FORMS, REPLIES, SENSORS, Faults
from beamtouch_models.places import Place, in_words

MEND = "mend"

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Load(NamedTuple):
    """The load at one instant; its place is None if nothing touches."""

    place_mm: Place | None
    force_n: float


NOTHING = Load(None, 0.0)
Ends = float | tuple[float, float]
"""A number that stays, or numbers at the start and at the end of a step."""


class Step(Strict):
    """One step of a script: no load without a place, a resting load with one place, a moving load with two."""

    seconds: PositiveFinite
    """Length of the step."""
    position_mm: Finite | Pair | None = None
    """Place of the load on a beam, or places at the start and the end of the step. Without a place, nothing touches."""
    x_mm: Finite | Pair | None = None
    """The same on a plate, along x."""
    y_mm: Finite | Pair | None = None
    """The same on a plate, along y."""
    force_n: NotNegative | Annotated[tuple[NotNegative, NotNegative], Field(strict=False)] | None = None
    """Force of the load, or forces at the start and the end of the step."""

    @model_validator(mode="after")
    def _all_or_none(self) -> Self:
        if self.position_mm is not None and len(self.coordinates) > 1:
            raise ValueError("give position_mm on a beam, or x_mm and y_mm on a plate, not both")
        wanted = PLATE_AXES if {*self.coordinates} & {*PLATE_AXES} else BEAM_AXES
        stated = [*(axis in self.coordinates for axis in wanted), self.force_n is not None]
        if any(stated) and not all(stated):
            places = ", ".join(f"{axis}_mm" for axis in wanted)
            raise ValueError(f"give {places} and force_n together, or none of them for no load")
        return self

    @property
    def coordinates(self) -> dict[str, Ends]:
        """Axis -> coordinate of the load; none without a load."""
        stated = {axis: getattr(self, f"{axis}_mm") for axis in (*BEAM_AXES, *PLATE_AXES)}
        return {axis: ends for axis, ends in stated.items() if ends is not None}

    def at(self, fraction: float) -> Load:
        """Return the load at a fraction 0..1 of the step."""
        if self.force_n is None:
            return NOTHING
        place_mm = tuple(_between(ends, fraction) for ends in self.coordinates.values())
        return Load(place_mm if len(place_mm) > 1 else place_mm[0], _between(self.force_n, fraction))


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


def _between(ends: Ends, fraction: float) -> float:
    if not isinstance(ends, tuple):
        return ends
    return ends[0] + fraction * (ends[1] - ends[0])


def load_script(path: Path, outline: Outline) -> Script:
    """Read a script file for a structure of this outline; raises InputError with the reason if it is wrong."""
    script, what = load_toml(Script, path), "beam" if outline.axes == BEAM_AXES else "plate"
    for number, step in enumerate(script.step, start=1):
        for axis, ends in step.coordinates.items():
            where = f"{path}: step {number}: {axis}_mm"
            if axis not in outline.axes:
                raise SceneError(f"{where} is not for a {what}; give {_keys_of(outline)}")
            length_mm = outline.lengths_mm[axis]
            if not all(0 <= end <= length_mm for end in (ends if isinstance(ends, tuple) else (ends,))):
                raise SceneError(f"{where} must lie on the {what}, 0..{length_mm:g} mm")
    return script


def _keys_of(outline: Outline) -> str:
    return " and ".join(f"{axis}_mm" for axis in outline.axes)


def default_script(scene: Scene) -> Script:
    """Return a script of about 20 s that touches, rests, moves and lifts over the whole range of a scene.

    On a plate, the loads lie on the line from the upper left to the lower right.
    """
    weak, strong = scene.contact.force_range_n
    middle, ranges_mm = (weak + strong) / 2, scene.contact.ranges_mm

    def step(seconds: float, fractions: Ends, force_n: Ends) -> Step:
        ends = fractions if isinstance(fractions, tuple) else (fractions,)
        place: dict[str, Ends] = {}
        for falls, (axis, (low, high)) in enumerate(zip(axes_of(len(ranges_mm)), ranges_mm, strict=True)):
            along = [low + (1 - end if falls else end) * (high - low) for end in ends]
            place[f"{axis}_mm"] = (along[0], along[1]) if len(along) > 1 else along[0]
        return Step.model_validate({"seconds": seconds, "force_n": force_n, **place})

    return Script(
        step=[
            Step(seconds=1.0),
            step(2.0, 0.25, middle),
            step(3.0, (0.25, 0.75), middle),
            step(1.5, 0.75, middle),
            Step(seconds=1.0),
            step(2.0, 0.5, strong),
            step(3.0, (0.5, 0.2), (strong, middle)),
            Step(seconds=1.0),
            step(1.5, 0.4, (weak + middle) / 2),
            step(2.5, (0.4, 0.8), (middle, strong)),
        ]
    )


class ByHand:
    """The load of the last line touches the surface. An empty line lifts it. Faults stay until `mend`."""

    def __init__(self, outline: Outline, faults: Faults) -> None:
        self._outline, self._faults = outline, faults
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
        if line.partition(":")[0] in (*SENSORS, *REPLIES):
            self._faults.add(line, seconds)
            return f"{line} is on"
        self._load = load_of(line, self._outline)
        place_mm, force_n = self._load
        return "nothing is on" if place_mm is None else f"{force_n:g} N at {in_words(place_mm)} mm is on"


def load_of(line: str, outline: Outline) -> Load:
    """Read a place and a force, or nothing; raises ValueError with the reason in one line."""
    words = line.split()
    if not words:
        return NOTHING
    try:
        *place_mm, force_n = map(float, words)
    except ValueError:
        place_mm, force_n = [], math.nan
    if len(place_mm) != len(outline.axes):
        form = "a position in mm and a force in N, as in 150 10"
        if outline.axes != BEAM_AXES:
            form = f"{' and '.join(outline.axes)} in mm and a force in N, as in 150 80 10"
        raise ValueError(
            f"give {form}, or an empty line to lift the load; or a fault, {FORMS}, or {MEND} to end all faults"
        )
    lies_on = all(0 <= mm <= length for mm, length in zip(place_mm, outline.lengths_mm.values(), strict=True))
    if not (lies_on and 0 <= force_n < math.inf):
        raise ValueError(f"{force_n:g} N at {in_words(place_mm)} mm is no load on {outline}")
    return Load(tuple(place_mm) if len(place_mm) > 1 else place_mm[0], force_n)
