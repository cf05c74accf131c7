"""A line in a hall that warms: contacts on a beam whose zeros drift, through daemon and service in simulated time.

Readings go through the daemon's processing and the service's surface and record. The truth of each contact is known, so
what was said can be compared with it.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from beamtouch_daemon.config.settings import Surface as Settings
from beamtouch_daemon.processing.filters import rest_of
from beamtouch_daemon.processing.pipeline import Pipeline, Taken
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.arrays import Floats
from beamtouch_models.modelfile import ModelFile, State
from beamtouch_models.scene import parse_scene
from beamtouch_models.surface import Surface as Physics
from beamtouch_models.world import World, counts_of_output, output_of_gap
from beamtouch_service.events.boot import Boot
from beamtouch_service.events.event import Event, EventKind
from beamtouch_service.events.health import HealthHistory
from beamtouch_service.samples import Batch
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.channels import ChannelHealth
from beamtouch_service.surfaces.surface import Surface as Served

CHUNK_S = 0.05
"""Readings that are taken together."""
BEGIN_S = 1.7e9
SETTLED_S = 0.15
"""Time from a touch, and before a lift, in which nothing is judged."""


@dataclass(frozen=True)
class Press:
    """A contact of the truth."""

    begin_s: float
    end_s: float
    position_mm: float
    force_n: float


@dataclass(frozen=True)
class Course:
    """What happens on a line."""

    seconds: float
    presses: list[Press]
    zero_mm: Callable[[Floats], Floats]
    """From times [s] (readings,) to the zeros (readings, channels)."""
    gain: tuple[float, float] = (0.0, 1.0)
    """A time from which the gain of the second channel is another one, and that gain."""
    creeps_s: float = 0.0
    """Time in which a press comes, and goes."""


def regular(
    model: ModelFile, seconds: float, every_s: float, held_s: float, rng: np.random.Generator, edge: float = 0.1
) -> list[Press]:
    """Return presses anywhere but near the ends, of any force of the model, at a regular pace."""
    (low, high), (least, most) = model.metadata.ranges.position_mm, model.metadata.ranges.force_n
    begins = np.arange(3.0, seconds - held_s - 1, every_s)
    places = rng.uniform(low + edge * (high - low), high - edge * (high - low), len(begins))
    forces = rng.uniform(least, most, len(begins))
    each = zip(begins.tolist(), places.tolist(), forces.tolist(), strict=True)
    return [Press(begin, begin + held_s, place, force) for begin, place, force in each]


def linear(um_per_min: Floats) -> Callable[[Floats], Floats]:
    """Return zeros that drift evenly, at these rates (channels,)."""
    return lambda at_s: at_s[:, None] / 60 * um_per_min / 1e3


@dataclass
class Outcome:
    """What was said."""

    contacts: int = 0
    lost: int = 0
    """Contacts in which no settled sample was one."""
    wrong: int = 0
    """Contacts in which a settled one without a note was further off than twice its half-interval."""
    held: float = 0.0
    """Share of settled samples without a note whose intervals hold the place."""
    held_force: float = 0.0
    false: int = 0
    """Events that are contacts where there is none."""
    shares: dict[str, float] = field(default_factory=dict)
    """Share of time at rest by what is said of it."""
    gains: set[str] = field(default_factory=set)
    """Channels whose gain was ever said to have changed."""
    zeros: set[str] = field(default_factory=set)
    error_mm: float = 0.0
    interval_mm: float = 0.0
    zero_error_um: float = 0.0
    """Largest distance of a tracked zero from the true one at the end."""
    noticed_s: float | None = None
    """First time at which the state is unexplained [s]."""
    unexplained_s: float = 0.0
    said: Counter[str] = field(default_factory=Counter)
    health: dict[str, ChannelHealth] = field(default_factory=dict)


class Line:
    """A surface with its daemon and its service."""

    def __init__(self, model: ModelFile, settings: Settings, seed: int = 0) -> None:
        self.model, self.settings = model, settings
        metadata = model.metadata
        scene = parse_scene(metadata.scene, metadata.name)
        noise_mm = Physics.of_model(metadata).readings.sensor_mm
        self._world = World.of(scene, metadata.sensor, metadata.layout_mm, noise_mm, None, (0.0, metadata.length_mm))
        self.rng = np.random.default_rng(seed)
        self.pipeline = Pipeline(settings, None, rest_of(settings))
        section = SurfaceSection(stale_ms=1000)
        self.surface = Served("bench", model, section)
        self._boot = Boot("bench", section, "boot-0001", model, 0)
        self._health = HealthHistory("bench", model, None)
        self.events: list[Event] = []

    def play(self, course: Course) -> Outcome:
        """Play a course from the last tare on."""
        outcome, rest, judged = Outcome(contacts=len(course.presses)), Counter[str](), list[tuple[bool, ...]]()
        seen, wrong = set[int](), set[int]()
        errors, intervals = [], []
        for at_s, counts in self._readings(course):
            readings = [Reading(t, tuple(row)) for t, row in zip(at_s.tolist(), counts.tolist(), strict=True)]
            taken = self.pipeline.process(readings, BEGIN_S)
            if not taken:
                continue
            decisions = self._receive(taken)
            for one, decision in zip(taken, decisions, strict=True):
                t = one.monotonic_s
                if decision.state is None:
                    continue
                outcome.said.update(decision.notes(self.model))
                if decision.state is State.UNEXPLAINED and outcome.noticed_s is None:
                    outcome.noticed_s = t
                index = int(np.searchsorted([press.begin_s for press in course.presses], t, side="right")) - 1
                press = course.presses[index] if index >= 0 else None
                if press and press.begin_s <= t <= press.end_s + 0.5:
                    if not press.begin_s + SETTLED_S <= t <= press.end_s - SETTLED_S:
                        continue
                    if decision.state is not State.CONTACT:
                        outcome.said[f"{decision.state.value} under a contact"] += 1
                        continue
                    seen.add(index)
                    figures, notes = decision.figures, decision.notes(self.model)
                    assert figures.position is not None
                    low, mm, high = figures.position_low_mm, figures.position_mm, figures.position_high_mm
                    intervals.append(high - low)
                    errors.append(abs(mm - press.position_mm))
                    if notes:
                        continue
                    half = high - mm if press.position_mm > mm else mm - low
                    if abs(mm - press.position_mm) > 2 * half:
                        wrong.add(index)
                    is_force = figures.force_low_n is None or (
                        figures.force_low_n <= press.force_n <= figures.force_high_n
                    )
                    judged.append((low <= press.position_mm <= high, is_force))
                else:
                    rest[decision.state.value] += 1
        outcome.lost, outcome.wrong = len(course.presses) - len(seen), len(wrong)
        if judged:
            outcome.held, outcome.held_force = (float(value) for value in np.mean(judged, axis=0))
        if errors:
            outcome.error_mm, outcome.interval_mm = float(np.mean(errors)), float(np.median(intervals))
        outcome.shares = {state: count / max(1, rest.total()) for state, count in rest.items()}
        outcome.false = sum(
            not self._is_true(event, course) for event in self.events if event.kind is EventKind.CONTACT
        )
        outcome.unexplained_s = self.surface.stretches.total_s
        self._note_health(outcome)
        outcome.health = self._health.state.channels
        return outcome

    def _note_health(self, outcome: Outcome) -> None:
        for name, one in self._health.state.channels.items():
            if "gain" in one.changes:
                outcome.gains.add(name)
            if "zero" in one.changes:
                outcome.zeros.add(name)

    def _is_true(self, event: Event, course: Course) -> bool:
        begin, end = event.touched_us / 1e6 - BEGIN_S, event.last_us / 1e6 - BEGIN_S
        return any(press.begin_s - 0.1 <= end and begin <= press.end_s + 1.0 for press in course.presses)

    def _receive(self, taken: list[Taken]) -> list:
        names = self.settings.channel_names
        samples = [one.sample for one in taken]
        noise = None if self.settings.noise_mm is None else [self.settings.noise_mm] * len(names)
        batch = Batch.model_construct(
            boot_id="boot-0001", channels=names, newest_age_ms=0.0, samples=samples, noise_mm=noise, notes=[],
            sent_us=None, backlog=False, oldest=None, earlier=[], characteristic="c", beam=None,
        )  # fmt: skip
        received = self.surface.receive(batch, taken[-1].monotonic_s)
        for decision in received.decisions:
            self._boot.add(decision.estimate)
        change = self._boot.change()
        for event, _, _ in change.events:
            if event.event.end.value != "open":
                self.events.append(event.event)
        self._boot.made(change, {})
        if best := self._boot.take_best():
            self._health.add(best)
            self.surface.health = self._health.state
            self._marks(best)
        return received.decisions

    def _marks(self, best: list) -> None:
        self.ever = getattr(self, "ever", set())
        for name, one in self._health.state.channels.items():
            if "gain" in one.changes:
                self.ever.add(name)

    def _readings(self, course: Course) -> Iterator[tuple[Floats, Floats]]:
        rate_hz, sensor = self.settings.rate_hz, self.model.metadata.sensor
        chunk = max(1, round(CHUNK_S * rate_hz))
        channels = self._world.channels
        influence = [self._world.influence(press.position_mm) * press.force_n for press in course.presses]
        for begin in range(0, round(course.seconds * rate_hz), chunk):
            at_s = (begin + np.arange(chunk)) / rate_hz
            deflection = np.zeros((chunk, channels))
            for press, under in zip(course.presses, influence, strict=True):
                if press.begin_s > at_s[-1] or press.end_s < at_s[0]:
                    continue
                share = ((at_s >= press.begin_s) & (at_s < press.end_s)).astype(float)
                if course.creeps_s:
                    up = np.clip((at_s - press.begin_s) / course.creeps_s, 0, 1)
                    down = np.clip((press.end_s - at_s) / course.creeps_s, 0, 1)
                    share = np.minimum(up, down)
                deflection += share[:, None] * under
            changed_s, gain = course.gain
            deflection[at_s >= changed_s, 1] *= gain
            noise = self._world.noise_mm * self.rng.normal(size=deflection.shape)
            shown = deflection + course.zero_mm(at_s) + noise
            yield at_s, counts_of_output(sensor, output_of_gap(sensor, sensor.standoff_mm - shown)).astype(float)
