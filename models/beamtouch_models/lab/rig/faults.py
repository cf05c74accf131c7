"""Faults that the rig plays: sensors, cables and replies that go wrong, always or for a time. Pure; no I/O."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beamtouch_common.errors import InputError
from beamtouch_models.arrays import Floats

SENSORS = {"unplugged": "one sensor", "stuck": "one sensor", "inverted": "one sensor", "swapped": "two sensors"}
"""Faults of sensors and their cables, and the sensors that each takes."""
REPLIES = {"lost": ("percentage", 100.0), "late": ("delay in ms", 60_000.0), "pause": None}
"""Faults of replies: the argument, and its largest value."""
FORMS = "unplugged:s1, stuck:s1, inverted:s1, swapped:s1,s2, lost:10 (percent), late:80 (ms) or pause"
_TIMES = re.compile(r"(\d+\.?\d*)\.\.(\d+\.?\d*)?(?:/(\d+\.?\d*))?")


@dataclass(frozen=True)
class Fault:
    """One fault. It is on from `begin_s` to `end_s`, and again after each period."""

    word: str
    channels: tuple[int, ...] = ()
    amount: float = math.nan
    """Percentage of the replies that are lost, or delay of the replies in ms; NaN for other faults."""
    begin_s: float = 0.0
    end_s: float = math.inf
    period_s: float = math.inf

    def left_s(self, seconds: float) -> float:
        """Return for how long the fault stays on after a time since the start; 0 if it is off."""
        since_s = seconds - self.begin_s
        if since_s < 0:
            return 0.0
        return max(0.0, self.end_s - self.begin_s - since_s % self.period_s)


class Faults:
    """The faults of a rig, in the order in which they were given.

    Parameters
    ----------
    sensors : names of the sensors, in the order of the channels
    texts : each fault as `--fault` states it
    seed : of the lost replies
    own_line : whether the rig can delay replies and leave them out

    Raises
    ------
    InputError
        A fault is wrong, with the reason in one line.
    """

    def __init__(
        self, sensors: Sequence[str], texts: Iterable[str] = (), seed: int = 0, *, own_line: bool = True
    ) -> None:
        self._sensors, self._own_line = tuple(sensors), own_line
        self._faults = tuple(self._read(text) for text in texts)
        self._held: dict[Fault, float] = {}
        self._rng = np.random.default_rng(seed)

    def add(self, text: str, seconds: float) -> None:
        """Begin a fault at a time since the start, until `mend`; raises InputError if it is wrong or states times."""
        if "@" in text:
            raise InputError(f"{text}: a fault that is typed begins at once and ends with mend; leave out @")
        self._faults = (*self._faults, replace(self._read(text), begin_s=seconds))

    def mend(self) -> None:
        """End all faults."""
        self._faults = ()

    def change(self, outputs: Floats, seconds: float) -> Floats:
        """Return the outputs (channels,), 0 to 1, that reach the converter at a time since the start."""
        changed = outputs.copy()
        for fault in self._faults:
            channels = list(fault.channels)
            if not fault.left_s(seconds):
                self._held.pop(fault, None)
            elif fault.word == "unplugged":
                changed[channels] = 0.0
            elif fault.word == "stuck":
                changed[channels] = self._held.setdefault(fault, float(changed[channels[0]]))
            elif fault.word == "inverted":
                changed[channels] = 1.0 - changed[channels]
            elif fault.word == "swapped":
                changed[channels] = changed[channels[::-1]]
        return changed

    def pause_s(self, seconds: float) -> float:
        """Return for how long the device does nothing after a time since the start."""
        return max((fault.left_s(seconds) for fault in self._faults if fault.word == "pause"), default=0.0)

    def delay_s(self, seconds: float) -> float | None:
        """Return the delay of a reply at a time since the start; None if the reply is lost."""
        on = [fault for fault in self._faults if fault.left_s(seconds)]
        if any(fault.word == "lost" and self._rng.uniform(0, 100) < fault.amount for fault in on):
            return None
        return sum(fault.amount for fault in on if fault.word == "late") / 1000

    def _read(self, text: str) -> Fault:
        what, mark, times = text.strip().partition("@")
        word, colon, argument = what.partition(":")
        try:
            if word in SENSORS:
                fault = Fault(word, channels=self._channels(word, argument))
            elif word not in REPLIES:
                raise ValueError(f"no such fault; give {FORMS}")
            elif not self._own_line:
                raise ValueError("with --firmware or a real serial device, only faults of sensors are played")
            else:
                fault = Fault(word, amount=_amount(word, colon + argument))
            return _timed(fault, times) if mark else fault
        except ValueError as error:
            raise InputError(f"fault {text.strip()}: {error}") from None

    def _channels(self, word: str, argument: str) -> tuple[int, ...]:
        names = argument.split(",") if argument else []
        for name in names:
            if name not in self._sensors:
                raise ValueError(f"there is no sensor {name}; the sensors are {', '.join(self._sensors)}")
        two = word == "swapped"
        if not len(names) == len(set(names)) == 1 + two:
            raise ValueError(f"give {SENSORS[word]}, as in {word}:{'s1,s2' if two else 's1'}")
        return tuple(map(self._sensors.index, names))


def _amount(word: str, argument: str) -> float:
    """Read what stands after the word, its colon included."""
    limit = REPLIES[word]
    if limit is None:
        if argument:
            raise ValueError(f"give times instead, as in {word}@10..12")
        return math.nan
    name, largest = limit
    try:
        amount = float(argument[1:])
    except ValueError:
        amount = math.nan
    if not 0 < amount <= largest:
        raise ValueError(f"give a {name} up to {largest:g}, as in {word}:{'10' if word == 'lost' else '80'}")
    return amount


def _timed(fault: Fault, times: str) -> Fault:
    if match := _TIMES.fullmatch(times):
        begin_s, end_s, period_s = (float(text or "inf") for text in match.groups())
        if begin_s < end_s and (end_s - begin_s < period_s or period_s == math.inf):
            return replace(fault, begin_s=begin_s, end_s=end_s, period_s=period_s)
    message = (
        "after @ give the seconds from which and until which it is on, as in @10..20, or @10.., "
        "or @0..0.06/0.4 for 0.06 s every 0.4 s"
    )
    raise ValueError(message)
