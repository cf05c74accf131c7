"""One commissioning of a surface: its steps, and what the samples so far say. No web, no files, no wall clock."""

from collections.abc import Iterator, Mapping, Sequence
from math import isnan
from typing import NamedTuple

import numpy as np

from beamtouch_common.outline import BEAM_AXIS
from beamtouch_models.runtime import InfluenceCurve, Metadata, ModelFile, State
from beamtouch_service.commissioning.pressing import HOLD_US, Floats, Movement, PressFinder, Stage
from beamtouch_service.commissioning.report import Finding, PlaceResult, Report, SensorResult
from beamtouch_service.commissioning.verdict import (
    UNSEEN,
    SensorFinding,
    advise,
    advise_places,
    advise_unseen,
    is_right,
    judge_place,
    judge_sensors,
)
from beamtouch_service.commissioning.wiring import Explanation, Press, explain
from beamtouch_service.samples import Quality, Sample
from beamtouch_service.surfaces.contact import Figures, rfc3339

PLACES = 3
"""Number of marked places, spread over the range of contacts."""
_WELL_SEEN = 0.25
"""A mark is where a force of at most this part of the largest one is seen: a support holds the beam."""
_STATED = ("position_mm", "position_low_mm", "position_high_mm")
_MM_DIGITS, _SHARE_DIGITS, _FORCE_DIGITS = 5, 3, 2


class PressDecision(NamedTuple):
    """The surface's decision on a sample of a press."""

    state: State | None
    figures: Figures | None = None
    reason: str = ""
    """Why there is no state."""


class CommissioningRun:
    """A commissioning that is under way, under one model."""

    def __init__(self, run_id: str, surface: str, model: ModelFile, stale_ms: float, now_us: int) -> None:
        """Begin at `now_us` [us since 1970, by the clock of the service]; samples may be `stale_ms` apart."""
        self.id, self.model = run_id, model
        metadata = model.metadata
        low_mm, high_mm = metadata.ranges.position_mm
        self.report = Report(
            surface=surface,
            model=model.identity,
            beam=metadata.beam,
            begun_at=rfc3339(now_us),
            sensors=[
                SensorResult(name=one.name, at_mm=min(max(one.position_mm, low_mm), high_mm)) for one in metadata.layout
            ],
            places=[PlaceResult(at_mm=at_mm) for at_mm in marks(metadata)],
        )
        self.step = 0
        """The current step, counted from 0: a press above each sensor, then one at each mark."""
        self._curve = InfluenceCurve.of(metadata)
        self._finder = PressFinder(metadata.noise.reading_mm, max(HOLD_US, stale_ms * 1e3))
        self._boot_id = ""
        self._presses: dict[int, Press] = {}
        """Sensor -> the press above it."""
        self._seen_held = PressDecision(None)
        """The surface's decision on the press that awaits its lift."""
        self._bad_held: dict[str, Quality] = {}
        """Channels that were not good in it."""
        self._bad: dict[str, Quality] = {}
        """Channels that were not good in a press."""
        self._explanation: Explanation | None = None
        self._findings: list[SensorFinding] = []

    @property
    def steps(self) -> int:
        """The number of steps."""
        return len(self.report.sensors) + len(self.report.places)

    @property
    def is_done(self) -> bool:
        """True if every step is done."""
        return self.step >= self.steps

    @property
    def stage(self) -> Stage | None:
        """The awaited action of the current step; None once every step is done."""
        return None if self.is_done else self._finder.stage

    @property
    def held(self) -> float:
        """Fraction of the hold time that has elapsed, 0 to 1."""
        return self._finder.held

    @property
    def at_mm(self) -> float | None:
        """The place to press now; None once every step is done."""
        report = self.report
        places = [sensor.at_mm for sensor in report.sensors] + [place.at_mm for place in report.places]
        return None if self.is_done else places[self.step]

    @property
    def prompt(self) -> str:
        """Instruction for the current step."""
        if self.is_done:
            return "Every step is done. Read the verdict, and put it on record."
        if self._finder.stage is Stage.REST:
            return "Take everything off the beam, and wait until it lies still."
        if self._finder.stage is Stage.LIFT:
            return "Seen. Lift, and wait until the beam lies still."
        if self._finder.stage is Stage.HOLD:
            return "Hold."
        sensors = self.report.sensors
        where = f"above {sensors[self.step].name}" if self.step < len(sensors) else "at the mark"
        return f"Press {where}, {self.at_mm:.0f} mm from the left end, firmly, for a second or two."

    def take(self, boot_id: str, channels: Sequence[str], sample: Sample, seen: PressDecision) -> Iterator[None]:
        """Take the next sample of the surface in steps, its values in the order of `channels`."""
        if self.is_done:
            return
        if boot_id != self._boot_id:
            self._boot_id = boot_id
            self._finder.forget()
        values = dict(zip(channels, sample.deflection_mm, strict=True))
        deflection_mm = np.array([values[name] for name in self.model.channels], np.float64)  # NaN for None
        was_held = self.stage is Stage.HOLD
        moved = self._finder.add(sample.acquired_unix_us, deflection_mm, seen.state)
        if was_held and self.stage is Stage.LIFT:
            qualities = dict(zip(channels, sample.quality, strict=True))
            self._bad_held = {name: one for name, one in qualities.items() if one is not Quality.GOOD}
            self._seen_held = seen
        if moved is None:
            return
        if self.step < len(self.report.sensors):
            yield from self._take_sensor(moved, self._bad_held)
        else:
            self._take_place(self._seen_held)
            self._advance()

    def skip(self) -> None:
        """End the current step without a press that was seen."""
        sensors = self.report.sensors
        if self.step < len(sensors):
            self._update(self.step, finding=Finding.UNSEEN, says=UNSEEN)
        else:
            self._take_place(PressDecision(None, reason=UNSEEN))
        self._finder.forget()
        self._advance()

    def _take_sensor(self, moved: Movement, bad: Mapping[str, Quality]) -> Iterator[None]:
        step, sensor = self.step, self.report.sensors[self.step]
        presses = self._presses | {step: Press(sensor.at_mm, *moved)}
        explanation = yield from explain(list(presses.values()), self._influence)
        if self.step != step:  # it was skipped meanwhile
            return
        moved_mm = [None if isnan(one) else round(one, _MM_DIGITS) for one in moved.moved_mm.tolist()]
        self._update(
            self.step,
            moved_mm=dict(zip(self.model.channels, moved_mm, strict=True)),
            quality=bad.get(sensor.name, Quality.GOOD),
        )
        self._presses, self._explanation = presses, explanation
        self._bad |= bad
        self._findings = judge_sensors(self._explanation, self.model.channels, self._bad)
        # What was said of a sensor may change with each press: all of them are judged together.
        for index, force_n in zip(self._presses, self._explanation.forces_n, strict=True):
            share = float(self._explanation.shares[index])
            self._update(
                index,
                **self._findings[index]._asdict(),
                share=None if isnan(share) else round(share, _SHARE_DIGITS),
                force_n=round(force_n, _FORCE_DIGITS),
            )
        self._advance()

    def _influence(self, places_mm: Floats) -> Floats:
        positions_mm = np.clip(places_mm, *self.model.metadata.ranges.position_mm)
        influence, _ = self._curve.at(positions_mm[:, None])
        return influence

    def _take_place(self, seen: PressDecision) -> None:
        index = self.step - len(self.report.sensors)
        position, force = (seen.figures.place[BEAM_AXIS], seen.figures.force) if seen.figures else (None, None)
        stated = dict(zip(_STATED, position or (None, None, None), strict=True)) | {"force_n": force and force.middle}
        place = self.report.places[index].model_copy(update={"state": seen.state, **stated})
        self.report.places[index] = judge_place(place, seen.reason)

    def _update(self, index: int, **members: object) -> None:
        self.report.sensors[index] = self.report.sensors[index].model_copy(update=members)

    def _advance(self) -> None:
        self.step += 1
        sensors, places = self.report.sensors, self.report.places
        if self.step < len(sensors):
            return
        unseen = [one.name for one in sensors if one.finding is Finding.UNSEEN]
        wiring = advise(self._explanation, self.model.channels, self._findings) if self._explanation else []
        self.report.verdict = [*advise_unseen(unseen), *wiring]
        if not self.is_done:
            return
        is_wired = all(one.finding is Finding.RIGHT for one in sensors)
        self.report.passed = is_wired and all(map(is_right, places))
        self.report.verdict += advise_places(places, is_wired=is_wired)
        if self.report.passed:
            self.report.verdict.insert(0, "Every sensor moves as it should, and the surface finds each mark.")


def marks(metadata: Metadata) -> list[float]:
    """Return the marked places: in each part of the range near its middle, where a press is well seen [mm]."""
    low_mm, high_mm = metadata.ranges.position_mm
    strong_n = metadata.ranges.force_n[1]
    table = list(zip(metadata.smallest_force.position_mm, metadata.smallest_force.force_n, strict=True))
    found = []
    for part in range(PLACES):
        begin_mm, end_mm = (low_mm + (high_mm - low_mm) * (part + one) / PLACES for one in (0, 1))
        middle_mm = (begin_mm + end_mm) / 2
        seen = {at_mm: force_n for at_mm, force_n in table if force_n is not None and begin_mm < at_mm < end_mm}
        well = [at_mm for at_mm, force_n in seen.items() if force_n <= _WELL_SEEN * strong_n]
        _, nearest_mm = min((abs(at_mm - middle_mm), at_mm) for at_mm in well or list(seen) or [middle_mm])
        found.append(float(round(nearest_mm)))
    return found
