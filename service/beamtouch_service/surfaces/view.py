"""One view of a surface at one moment: what its newest sample shows, or the problem that prevents a contact. Pure.

Routes, registers, topics, nodes and metrics read it, and nothing else of what a sample shows. It never changes, so any
thread may read it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Self

from beamtouch_common.outline import BEAM_AXES, Place, Span
from beamtouch_models.runtime import ModelFile, State
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Quality, Sample
from beamtouch_service.surfaces.channels import ChannelOut
from beamtouch_service.surfaces.follower import Decision
from beamtouch_service.surfaces.unexplained import Stretches
from beamtouch_service.surfaces.zones import ZoneStates


@dataclass(frozen=True, slots=True)
class Newest:
    """The newest sample and the decision on it."""

    boot_id: str
    channels: list[str]
    """The names of the values in the sample."""
    sample: Sample
    acquired_s: float
    sender_notes: list[str]
    """Notes on the sender: its own, and what the service says of it."""
    decided: tuple[ModelFile, Decision] | None = None
    """None without a model."""

    def age_ms(self, now_s: float) -> float:
        """Return the age at `now_s` [s, monotonic], rounded."""
        return round((now_s - self.acquired_s) * 1e3, 1)

    @property
    def bad(self) -> Mapping[str, Quality]:
        """Channels of the model that took no part."""
        return self.decided[1].estimate.bad if self.decided else {}


class Totals(NamedTuple):
    """Counts and alarms up to the newest sample."""

    zone_entries: Mapping[str, int]
    """Zone -> times that a contact came to be inside it since the start."""
    channels_out: Mapping[str, ChannelOut]
    """The channels that are out, by name."""
    unexplained: Stretches
    """The unexplained stretches."""


class ChannelView(NamedTuple):
    """One channel of the model."""

    name: str
    place_mm: Mapping[str, float]
    """Axis -> its coordinate: on a beam, its distance from the left end."""
    deflection_mm: float | None
    """Positive in the direction of the load; None without a current value."""
    quality: Quality
    unit: str
    """Unit of the deflection; mm unless the model was measured in another one."""


class View(NamedTuple):
    """A surface at one moment. Without a contact, there is a problem, and what belongs to contacts is None or empty."""

    surface: str
    now_s: float
    """The moment [s, monotonic]."""
    model: ModelFile | None
    """The model in use."""
    newest: Newest | None
    """The newest sample; None before the first."""
    is_current: bool
    """True if that sample is not too old."""
    problem: Problem | None
    """The problem that prevents a contact."""
    decided_by: ModelFile | None
    """The model that gave the answer: after a change of models, still the old one."""
    decision: Decision | None
    """The decision on the newest sample, if it stands."""
    totals: Totals
    """Counts and alarms up to the newest sample."""

    def require_contact(self) -> Self:
        """Return this view; raises ProblemError if a problem prevents a contact."""
        if self.problem:
            # A new exception each time: one that is raised again collects tracebacks.
            raise ProblemError(self.problem)
        return self

    @property
    def status(self) -> State | Kind:
        """The state, or the kind of the problem that prevents a contact."""
        if self.problem:
            return self.problem.kind
        assert self.decision  # noqa: S101  # without a problem there is one
        return self.decision.held

    @property
    def drawn_by(self) -> ModelFile | None:
        """The model of the structure and channels that belong to the answer; without an answer, the model in use."""
        return self.decided_by or self.model

    @property
    def answered_by(self) -> str | None:
        """Name and fingerprint of the model that gave the answer."""
        return self.decided_by.identity if self.decided_by else None

    @property
    def state(self) -> State | None:
        """The state."""
        return self.decision.held if self.decision else None

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes of the model that gave the answer."""
        return tuple(self.decided_by.metadata.axes) if self.decided_by else BEAM_AXES

    @property
    def place(self) -> Place:
        """The place of a contact; empty without one."""
        figures = self.decision.figures if self.decision else None
        return figures.place if figures else {}

    @property
    def force(self) -> Span | None:
        """The force of a contact; None without one, or if the model does not estimate it."""
        figures = self.decision.figures if self.decision else None
        return figures.force if figures else None

    @property
    def notes(self) -> list[str]:
        """Notes on the sender and on the sample."""
        if not (self.newest and self.decided_by and self.decision):
            return []
        return [*self.newest.sender_notes, *self.decision.notes(self.decided_by)]

    @property
    def misfit(self) -> float | None:
        """The misfit of rest or of the best single contact, rounded."""
        return self._misfits[0]

    @property
    def misfit_limit(self) -> float | None:
        """The limit of that misfit, rounded."""
        return self._misfits[1]

    @property
    def _misfits(self) -> tuple[float, float] | tuple[None, None]:
        if not (self.decided_by and self.decision):
            return None, None
        misfit, limit = self.decision.misfit(self.decided_by)
        return round(misfit, 2), round(limit, 2)

    @property
    def zones(self) -> ZoneStates:
        """Zone of the configuration -> its answer."""
        return self.decision.zones.answers if self.decision else {}

    @property
    def age_ms(self) -> float | None:
        """Age of the newest sample, rounded; None before the first."""
        return self.newest.age_ms(self.now_s) if self.newest else None

    @property
    def sequence(self) -> int | None:
        """Number of the newest sample; None before the first."""
        return self.newest.sample.sequence if self.newest else None

    @property
    def readings(self) -> int | None:
        """Number of readings in the sample of the contact; None if its sender does not say."""
        return self.newest.sample.readings if self.newest and self.decision else None

    @property
    def bad(self) -> Mapping[str, Quality]:
        """Channels of the model that took no part in the newest sample; empty if that sample is too old."""
        return self.newest.bad if self.newest and self.is_current else {}

    @property
    def qualities(self) -> dict[str, Quality]:
        """The channels of the model, or without one of the sender, with their quality in the newest sample.

        Empty if that sample is too old: nothing is known of the channels then.
        """
        newest = self.newest
        if newest is None or not self.is_current:
            return {}
        sent = dict(zip(newest.channels, newest.sample.quality, strict=True))
        names = self.drawn_by.channels if self.drawn_by else newest.channels
        return {name: newest.bad.get(name) or sent.get(name, Quality.MISSING) for name in names}

    @property
    def correlation(self) -> float | None:
        """Correlation of the two coordinates of a contact; None without one, or if the model does not estimate it."""
        figures = self.decision.figures if self.decision else None
        return figures.correlation if figures else None

    @property
    def channels(self) -> list[ChannelView]:
        """The channels in the order of the model; empty without one."""
        if self.drawn_by is None:
            return []
        newest, qualities, metadata = self.newest, self.qualities, self.drawn_by.metadata
        # A deflection that is too old for a contact must not be shown as current either.
        shown = newest if self.is_current else None
        deflections_mm = dict(zip(shown.channels, shown.sample.deflection_mm, strict=True)) if shown else {}
        return [
            ChannelView(
                channel.name,
                metadata.place_of(channel),
                deflections_mm.get(channel.name),
                qualities.get(channel.name, Quality.MISSING),
                channel.unit,
            )
            for channel in metadata.layout
        ]
