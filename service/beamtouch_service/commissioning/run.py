"""One commissioning of a surface: its steps, and what the samples so far say. No web, no files, no wall clock."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise, product
from math import isnan
from typing import NamedTuple

import numpy as np

from beamtouch_common.outline import BEAM_AXES, BEAM_AXIS
from beamtouch_common.units import MM
from beamtouch_models.runtime import Channel, InfluenceCurve, Metadata, ModelFile, State
from beamtouch_service.commissioning.pressing import HOLD_US, Floats, Movement, PressFinder, Stage
from beamtouch_service.commissioning.report import Finding, PlaceMm, PlaceResult, Report, SensorResult
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

PARTS = {1: (3,), 2: (2, 2)}
"""Number of axes -> parts of the range of contacts along each: each part has a marked place."""
_WELL_SEEN = 0.25
"""A mark is where a force of at most this part of the largest one is seen: a support holds the beam."""
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
        self.report = Report(
            surface=surface,
            model=model.identity,
            beam=metadata.beam,
            begun_at=rfc3339(now_us),
            unit=metadata.unit,
            sensors=[SensorResult(name=one.name, at_mm=_within(metadata, one)) for one in metadata.layout],
            places=[PlaceResult(at_mm=at_mm) for at_mm in marks(metadata)],
        )
        self.step = 0
        """The current step, counted from 0: a press above each sensor, then one at each mark."""
        self._curve = InfluenceCurve.of(metadata)
        self._finder = PressFinder(metadata.noise.reading_mm, max(HOLD_US, stale_ms * 1e3))
        self._boot_id = ""
        self._presses: dict[int, Press] = {}
        """Sensor -> the press above it."""
        self._held_decision = PressDecision(None)
        """The surface's decision on the press that awaits its lift."""
        self._held_bad: dict[str, Quality] = {}
        """Channels that were not good in it."""
        self._ever_bad: dict[str, Quality] = {}
        """Channels that were not good in a press above a sensor."""
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
    def at_mm(self) -> PlaceMm | None:
        """The place to press now, by axis; None once every step is done."""
        report = self.report
        places = [sensor.at_mm for sensor in report.sensors] + [place.at_mm for place in report.places]
        return None if self.is_done else places[self.step]

    @property
    def prompt(self) -> str:
        """Instruction for the current step."""
        if self.is_done:
            return "Every step is done. Read the verdict, and put it on record."
        kind = self.model.metadata.outline.kind
        if self._finder.stage is Stage.REST:
            return f"Take everything off the {kind}, and wait until it lies still."
        if self._finder.stage is Stage.LIFT:
            return f"Seen. Lift, and wait until the {kind} lies still."
        if self._finder.stage is Stage.HOLD:
            return "Hold."
        sensors = self.report.sensors
        where = f"above {sensors[self.step].name}" if self.step < len(sensors) else "at the mark"
        return f"Press {where}, {_in_words(self.at_mm or {})}, firmly, for a second or two."

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
            self._held_bad = {name: one for name, one in qualities.items() if one is not Quality.GOOD}
            self._held_decision = seen
        if moved is None:
            return
        if self.step < len(self.report.sensors):
            yield from self._take_sensor(moved, self._held_bad)
        else:
            self._take_place(self._held_decision)
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
        presses = self._presses | {step: Press(np.array(list(sensor.at_mm.values())), *moved)}
        explanation = yield from explain(list(presses.values()), self._influence)
        if self.step != step:  # it was skipped meanwhile
            return
        moved_mm = [None if isnan(one) else self._rounded(one) for one in moved.moved_mm.tolist()]
        self._update(
            self.step,
            moved_mm=dict(zip(self.model.channels, moved_mm, strict=True)),
            quality=bad.get(sensor.name, Quality.GOOD),
        )
        self._presses, self._explanation = presses, explanation
        self._ever_bad |= bad
        self._findings = judge_sensors(self._explanation, self.model.channels, self._ever_bad)
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

    def _rounded(self, moved: float) -> float:
        """Return a movement: to 10 nm if it is in mm, to digits that no sensor has in another unit."""
        return round(moved, _MM_DIGITS) if self.report.unit == MM else float(f"{moved:.{_MM_DIGITS}g}")

    def _influence(self, places_mm: Floats) -> Floats:
        extent = self.model.metadata.extent
        influence, _ = self._curve.at(np.clip(places_mm, extent.low_mm, extent.high_mm))
        return influence

    def _take_place(self, seen: PressDecision) -> None:
        index = self.step - len(self.report.sensors)
        stated_mm, force = (seen.figures.place, seen.figures.force) if seen.figures else (None, None)
        stated = {"stated_mm": stated_mm and dict(stated_mm), "force_n": force and force.middle}
        place = self.report.places[index].model_copy(update={"state": seen.state, **stated})
        self.report.places[index] = judge_place(place, seen.reason)

    def _update(self, index: int, **members: object) -> None:
        self.report.sensors[index] = self.report.sensors[index].model_copy(update=members)

    def _advance(self) -> None:
        """Go to the next step, and state the verdict as far as it is known."""
        self.step += 1
        if self.step < len(self.report.sensors):
            return
        self._judge_wiring()
        if self.is_done:
            self._judge_places()

    def _judge_wiring(self) -> None:
        sensors = self.report.sensors
        unseen = [one.name for one in sensors if one.finding is Finding.UNSEEN]
        names, kind = self.model.channels, self.model.metadata.outline.kind
        wiring = advise(self._explanation, names, self._findings, kind) if self._explanation else []
        self.report.verdict = [*advise_unseen(unseen, kind), *wiring]

    def _judge_places(self) -> None:
        sensors, places = self.report.sensors, self.report.places
        is_wired = all(one.finding is Finding.RIGHT for one in sensors)
        self.report.passed = is_wired and all(map(is_right, places))
        self.report.verdict += advise_places(places, is_wired=is_wired)
        if self.report.passed:
            self.report.verdict.insert(0, "Every sensor moves as it should, and the surface finds each mark.")


def _within(metadata: Metadata, sensor: Channel) -> PlaceMm:
    """Return the place nearest to a sensor at which the model knows contacts."""
    at_mm, ranges_mm = metadata.place_of(sensor), metadata.extent.ranges_mm
    return {axis: min(max(at_mm[axis], low), high) for axis, (low, high) in zip(at_mm, ranges_mm, strict=True)}


def _in_words(place_mm: PlaceMm) -> str:
    if tuple(place_mm) == BEAM_AXES:
        return f"{place_mm[BEAM_AXIS]:.0f} mm from the left end"
    return f"at {' and '.join(f'{axis} {at_mm:.0f}' for axis, at_mm in place_mm.items())} mm"


def marks(metadata: Metadata) -> list[PlaceMm]:
    """Return the marked places: in each part of the range near its middle, where a press is well seen [mm]."""
    strong_n, smallest = metadata.ranges.force_n[1], metadata.smallest_force
    columns = [smallest.position_mm, *([] if smallest.across_mm is None else [smallest.across_mm])]
    place_mm = np.array(columns).T
    force_n = np.array(smallest.force_n, np.float64)  # NaN for None
    ranges_mm = metadata.extent.ranges_mm
    ticks = [np.linspace(*ends, parts + 1) for ends, parts in zip(ranges_mm, PARTS[len(ranges_mm)], strict=True)]
    found = []
    for part in product(*(pairwise(one.tolist()) for one in ticks)):
        begin_mm, end_mm = np.array(part).T
        middle_mm = (begin_mm + end_mm) / 2
        is_seen = np.isfinite(force_n) & ((place_mm > begin_mm) & (place_mm < end_mm)).all(axis=1)
        is_well_seen = is_seen & (force_n <= _WELL_SEEN * strong_n)
        near_mm = place_mm[is_well_seen if is_well_seen.any() else is_seen]
        if not len(near_mm):
            near_mm = middle_mm[None]
        nearest_mm = near_mm[np.hypot.reduce(np.abs(near_mm - middle_mm), axis=1).argmin()]
        found.append(dict(zip(metadata.axes, nearest_mm.round().tolist(), strict=True)))
    return found
