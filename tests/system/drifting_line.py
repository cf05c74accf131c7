"""A line in a hall that warms: contacts on a beam whose zeros drift, through daemon and service in simulated time.

Readings go through the daemon's processing, and its samples through the service's surface, record and health. What was
said is compared with the truth.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from beamtouch_common.outline import BEAM_AXIS
from beamtouch_daemon.config.settings import Surface as Settings
from beamtouch_daemon.processing.filters import rest_of
from beamtouch_daemon.processing.pipeline import Pipeline, TimedSample
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.arrays import Floats
from beamtouch_models.design.scene import parse_scene
from beamtouch_models.design.surface import resolve_model
from beamtouch_models.design.world import Motion, World, counts_of_output, output_of_gap
from beamtouch_models.filters import TARED, Rested
from beamtouch_models.places import Extent
from beamtouch_models.runtime import ModelFile, State
from beamtouch_service.record.events.boot_record import BootRecord
from beamtouch_service.record.events.event import Event, EventKind
from beamtouch_service.record.events.health import HealthHistory, StoredHealth
from beamtouch_service.samples import Batch
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.follower import Decision
from beamtouch_service.surfaces.surface import Surface as Served

BOOT, BEGIN_S = "boot-0001", 1.7e9
CHUNK_S = 0.25
"""Time of the readings that are processed together."""
SETTLED_S = 0.15
"""Time after a touch, and before a lift, in which nothing is judged."""
LIFTED_S = 0.5
"""Time after a lift in which nothing is judged."""
EDGE = 0.1
"""Part of the range of contacts at each end where none is drawn: light ones are not seen there."""


@dataclass(frozen=True)
class Press:
    """A contact of the truth."""

    begin_s: float
    end_s: float
    position_mm: float
    force_n: float
    creeps_s: float = 1e-9
    """Time in which it comes, and goes."""

    def force_at(self, at_s: Floats) -> Floats:
        """Return its force at some times."""
        ends = [self.begin_s, self.begin_s + self.creeps_s, self.end_s - self.creeps_s, self.end_s]
        forces: Floats = np.interp(at_s, ends, [0.0, self.force_n, self.force_n, 0.0])
        return forces


@dataclass(frozen=True)
class Course:
    """What happens on a line."""

    seconds: float
    presses: Sequence[Press]
    zero_mm: Callable[[Floats], Floats]
    """From times [s] (readings,) to zeros (readings, channels)."""
    gain: float = 1.0
    """Gain of the second channel in the second half of the time."""


def drift(um_per_min: float, channels: Sequence[float]) -> Callable[[Floats], Floats]:
    """Return zeros that drift evenly; `channels` has the share of each."""
    return lambda at_s: 1e-3 * um_per_min / 60 * at_s[:, None] * np.array(channels)


def knock(um: float, at_s: float, channels: Sequence[float]) -> Callable[[Floats], Floats]:
    """Return zeros that are moved at once; `channels` has the share of each."""
    return lambda now_s: np.where(now_s >= at_s, 1e-3 * um, 0.0)[:, None] * np.array(channels)


def presses(
    model: ModelFile, seconds: float, every_s: float, *, held_s: float | None = None, seed: int = 2
) -> list[Press]:
    """Return contacts of any force at a regular pace, half of the time unless they are held for another time."""
    rng, (low, high) = np.random.default_rng(seed), model.metadata.ranges.position_mm
    held_s = every_s / 2 if held_s is None else held_s
    begins = np.arange(3.0, seconds - held_s - LIFTED_S, every_s)
    places = rng.uniform(low + EDGE * (high - low), high - EDGE * (high - low), len(begins)).tolist()
    forces = rng.uniform(*model.metadata.ranges.force_n, len(begins)).tolist()
    each = zip(begins.tolist(), places, forces, strict=True)
    return [Press(begin, begin + held_s, place, force) for begin, place, force in each]


@dataclass
class Said:
    """What was said on a course."""

    presses: int
    seen: set[int] = field(default_factory=set)
    """Contacts of the truth in which a settled sample was one."""
    wrong: set[int] = field(default_factory=set)
    """Those in which one without a note was further off than twice its half-interval."""
    held: list[bool] = field(default_factory=list)
    """Whether the interval of each settled sample without a note holds the place, and then the force."""
    interval_mm: list[float] = field(default_factory=list)
    at_rest: Counter[str] = field(default_factory=Counter)
    under_contact: Counter[str] = field(default_factory=Counter)
    notes: Counter[str] = field(default_factory=Counter)
    unexplained_at_s: list[float] = field(default_factory=list)
    false: int = 0
    """Events that are contacts where there is none."""
    gains: set[str] = field(default_factory=set)
    """Channels whose gain was ever said to have changed."""

    @property
    def lost(self) -> int:
        """Contacts that were not seen."""
        return self.presses - len(self.seen)

    def share(self, state: State) -> float:
        """Return the share of the samples at rest that have a state."""
        return self.at_rest[state] / max(1, self.at_rest.total())


class Line:
    """A surface with its daemon and its service, from a start of both on."""

    def __init__(
        self, model: ModelFile, settings: Settings, seed: int = 0, rested: Rested = TARED, *, rings: bool = False
    ) -> None:
        self.model, self.settings, self.rng = model, settings, np.random.default_rng(seed)
        metadata, section = model.metadata, SurfaceSection(stale_ms=1000)
        scene, noise_mm = parse_scene(metadata.scene, metadata.name), resolve_model(metadata).readings.sensor_mm
        whole = Extent(((0.0, metadata.length_mm),))
        self._world = World.of(scene, metadata.sensor, metadata.layout_mm, noise_mm, None, whole)
        self._motion = Motion(self._world, rings=True) if rings else None
        self.pipeline = Pipeline(settings, None, rest_of(settings), rested)
        self.surface = Served(metadata.name, model, section)
        self._boot = BootRecord(metadata.name, section, BOOT, model, 0)
        self.health = HealthHistory(metadata.name, model, StoredHealth())

    def play(self, course: Course) -> Said:
        """Play a course."""
        said = Said(len(course.presses))
        for readings in self._readings(course):
            taken = self.pipeline.process(readings, BEGIN_S)
            for one, decision in zip(taken, self._receive(taken) if taken else [], strict=True):
                self._judge(said, course, one, decision)
            if taken:
                self._record(said, course)
        return said

    def _receive(self, taken: list[TimedSample]) -> list[Decision]:
        head = {"boot_id": BOOT, "channels": self.settings.channel_names, "newest_age_ms": 0.0, "characteristic": "c"}
        noise_mm = None if self.settings.noise_mm is None else [self.settings.noise_mm] * len(self.settings.channels)
        batch = Batch.model_validate(head | {"noise_mm": noise_mm, "samples": [one.sample for one in taken]})
        decisions = self.surface.receive(batch, taken[-1].monotonic_s).decisions
        for decision in decisions:
            self._boot.add(decision.estimate)
        return decisions

    def _judge(self, said: Said, course: Course, taken: TimedSample, decision: Decision) -> None:
        if decision.state is None:
            return
        at_s, notes = taken.monotonic_s, [*decision.notes(self.model), *taken.notes]
        said.notes.update(notes)
        if decision.state is State.UNEXPLAINED:
            said.unexplained_at_s.append(at_s)
        index = sum(press.begin_s <= at_s for press in course.presses) - 1
        press = course.presses[index] if index >= 0 else None
        if press is None or at_s > press.end_s + LIFTED_S:
            said.at_rest[decision.state] += 1
        elif press.begin_s + SETTLED_S <= at_s <= press.end_s - SETTLED_S:
            said.under_contact[decision.state] += 1
            figures = decision.figures
            if figures is None:
                return
            mm, low, high = figures.place[BEAM_AXIS]
            said.seen.add(index)
            said.interval_mm.append(high - low)
            if not notes:
                half_mm = high - mm if press.position_mm > mm else mm - low
                said.wrong |= {index} if abs(mm - press.position_mm) > 2 * half_mm else set()
                said.held.append(low <= press.position_mm <= high)
                if figures.force:
                    said.held.append(figures.force.low <= press.force_n <= figures.force.high)

    def _record(self, said: Said, course: Course) -> None:
        """Let the record and the health of the sensors follow."""
        change = self._boot.change()
        ended = [event.event for event, _, _ in change.events if event is not self._boot.event]
        said.false += sum(event.kind is EventKind.CONTACT and not _is_true(event, course) for event in ended)
        self._boot.note_durable(change, {})
        if best := self._boot.take_best():
            self.health.add(best)
            self.surface.health = self.health.state
            said.gains |= {name for name, one in self.health.state.channels.items() if "gain" in one.changes}

    def _readings(self, course: Course) -> Iterator[list[Reading]]:
        rate_hz, sensor = self.settings.rate_hz, self.model.metadata.sensor
        shapes = [self._world.influence(press.position_mm) for press in course.presses]
        size = max(1, round(CHUNK_S * rate_hz))
        for begin in range(0, round(course.seconds * rate_hz), size):
            at_s = (begin + np.arange(size)) / rate_hz
            true_mm = np.zeros((size, self._world.channels))
            for press, shape in zip(course.presses, shapes, strict=True):
                if press.begin_s <= at_s[-1] and at_s[0] <= press.end_s:
                    true_mm += press.force_at(at_s)[:, None] * shape
            if self._motion is not None:
                true_mm = self._rung_mm(self._motion, course, at_s)
            true_mm[at_s >= course.seconds / 2, 1] *= course.gain
            shown_mm = true_mm + course.zero_mm(at_s) + self._world.noise_mm * self.rng.normal(size=true_mm.shape)
            counts = counts_of_output(sensor, output_of_gap(sensor, sensor.standoff_mm - shown_mm)).tolist()
            yield [Reading(moment, tuple(row)) for moment, row in zip(at_s.tolist(), counts, strict=True)]

    @staticmethod
    def _rung_mm(motion: Motion, course: Course, at_s: Floats) -> Floats:
        """Return the deflections (readings, channels) of a beam that rings; one contact after the other touches it."""
        rows = []
        for now_s in at_s.tolist():
            last = [press for press in course.presses if press.begin_s <= now_s][-1:]
            force_n = sum(float(press.force_at(np.array(now_s))) for press in last)
            rows.append(motion.at(now_s, last[0].position_mm if last else 0.0, force_n))
        return np.array(rows)


def _is_true(event: Event, course: Course) -> bool:
    begin_s, end_s = (at_us / 1e6 - BEGIN_S for at_us in (event.touched_us, event.last_us))
    return any(press.begin_s <= end_s and begin_s <= press.end_s + LIFTED_S for press in course.presses)
