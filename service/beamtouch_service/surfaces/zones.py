"""The answer for each zone of a surface from consecutive samples, with hysteresis and dwell. Pure: no clock.

The caller gives each sample its time. The live answer takes that of the service's clock, from the ages of the samples,
which no wall clock changes. The record has only the sender's wall clock, so that it is a function of the samples: a
step back counts as no time, but a step forward cannot be told from samples at rest, which are as far apart, and counts.

Between two samples that follow each other, time counts as a whole. Where samples are missing in between, the contact
may have been away: hysteresis and dwell start over, but a contact that is there afterwards has not entered again. After
a pause longer than a contact is held, nothing is known of what was before.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from beamtouch_common.outline import Outline, Place, Span
from beamtouch_common.zones import BEGIN, HOLD, Zone, ZoneState

ZoneStates = dict[str, ZoneState | None]
"""Name of a zone -> its answer; None where there is no contact to judge."""


class ZoneEvidence(NamedTuple):
    """The evidence of a sample on contacts."""

    at_us: int
    """Its time, by the same clock as that of the sample before [us]."""
    is_clear: bool = False
    """True if it shows that nothing touches the beam."""
    place: Place | None = None
    """Of a contact that can be judged; None without one."""
    force: Span | None = None
    """None if the model does not estimate it."""


class ZoneReport(NamedTuple):
    """The zones as a sample shows them."""

    answers: ZoneStates
    stays_us: Mapping[str, int]
    """Zone that the contact is inside -> how much longer it has been so [us]."""
    entered: list[str]
    """Zones that the contact came to be inside, from outside or from where nothing was known."""


NO_ZONES = ZoneReport({}, {}, [])


@dataclass(slots=True)
class _Progress:
    """How far a contact has come in one zone, as the samples so far show it."""

    zone: Zone
    lies: ZoneState | None = None
    """How the contact lies to it; None without a contact that can be judged."""
    inside_us: int = 0
    """How long it has been in it without a break."""
    answer: ZoneState | None = None
    has_entered: bool = False
    """True if it was inside since it was outside last, or not known."""

    def step(self, evidence: ZoneEvidence, outline: Outline, passed_us: int) -> int | None:
        """Take the next sample; return the time that the contact has been inside more [us], None if it is not."""
        before, was_inside = self.lies, self.answer is ZoneState.INSIDE
        self.lies = self._lie(evidence, outline)
        self.inside_us = self.inside_us + passed_us if self.lies is before is ZoneState.INSIDE else 0
        self.answer = ZoneState.OUTSIDE if evidence.is_clear else self.lies
        if self.lies is ZoneState.INSIDE and self.inside_us < self.zone.dwell_ms * 1e3:
            self.answer = ZoneState.UNSURE
        if self.answer is not ZoneState.INSIDE:
            self.has_entered &= self.answer is ZoneState.UNSURE
            return None
        return passed_us if was_inside else self.inside_us

    def _lie(self, evidence: ZoneEvidence, outline: Outline) -> ZoneState | None:
        if evidence.place is None:
            return None
        now = self.zone.lies(evidence.place, evidence.force, outline, HOLD)
        return now if now is self.lies else self.zone.lies(evidence.place, evidence.force, outline, BEGIN)


class ZoneFollower:
    """Follows consecutive samples of one sender."""

    def __init__(
        self, zones: Mapping[str, Zone], outline: Outline, hold_us: float, memory: Mapping[str, Any] | None = None
    ) -> None:
        """Begin with samples of a structure that hold a contact for `hold_us`, or go on from a memory.

        A zone whose definition has changed starts over.

        Raises KeyError, TypeError or ValueError if `memory` is something else.
        """
        self.defined = dict(zones)
        self._outline, self._hold_us = outline, hold_us
        self._last_us = 0
        """Time of the last sample."""
        self._forget()
        if memory is not None:
            self._last_us = int(memory["last_us"])
            for name, (zone, lies, inside_us, answer, has_entered) in dict(memory["zones"]).items():
                if name in self.defined and self.defined[name].model_dump(mode="json") == zone:
                    then, said = (one and ZoneState(one) for one in (lies, answer))
                    self._progress[name] = _Progress(self.defined[name], then, int(inside_us), said, has_entered)

    def _forget(self) -> None:
        self._progress = {name: _Progress(zone) for name, zone in self.defined.items()}

    @property
    def memory(self) -> dict[str, Any]:
        """The state that it needs to go on in another process, as JSON."""
        kept = {
            name: [one.zone.model_dump(mode="json"), one.lies, one.inside_us, one.answer, one.has_entered]
            for name, one in self._progress.items()
        }
        return {"last_us": self._last_us, "zones": kept}

    def miss(self) -> None:
        """Note that samples before the next one are missing."""
        for progress in self._progress.values():
            progress.lies = progress.answer = None

    def step(self, evidence: ZoneEvidence) -> ZoneReport:
        """Take the next sample; return what it shows."""
        passed_us = max(0, evidence.at_us - self._last_us)
        self._last_us = evidence.at_us
        if passed_us > self._hold_us:
            self._forget()
        stays_us, entered = dict[str, int](), list[str]()
        for name, progress in self._progress.items():
            longer_us = progress.step(evidence, self._outline, passed_us)
            if longer_us is None:
                continue
            stays_us[name] = longer_us
            if not progress.has_entered:
                entered.append(name)
            progress.has_entered = True
        return ZoneReport({name: progress.answer for name, progress in self._progress.items()}, stays_us, entered)
