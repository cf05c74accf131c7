"""A surface at one time, as its registers show it: the contact of `GET /contact`, or the problem it answers with."""

from collections.abc import Mapping
from dataclasses import dataclass

from beamtouch_service.problems import Kind, ProblemError
from beamtouch_service.samples import Quality
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.surface import Surface


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One surface at one time."""

    surface: Surface
    now_s: float
    """The time [s, monotonic]."""
    outcome: Contact | Kind
    """The contact, or the problem that there is instead."""
    channels: list[str]
    """In the order of the model; empty without one."""
    bad: Mapping[str, Quality]
    """Channels that took no part in the newest sample; empty if that sample is too old."""
    age_ms: float | None
    """Age of the newest sample; None before the first."""
    sequence: int
    """Number of the newest sample; 0 before the first."""

    def channel_bits(self, quality: Quality) -> int:
        """Return a bit for each channel of this quality, the first channel in the lowest bit."""
        return self._bits({name for name, one in self.bad.items() if one is quality})

    @property
    def check_bits(self) -> int:
        """A bit for the channel that `check-NAME` names."""
        return self._bits({note.removeprefix("check-") for note in self.notes if note.startswith("check-")})

    @property
    def contact(self) -> Contact | None:
        """The contact; None if there is a problem."""
        return self.outcome if isinstance(self.outcome, Contact) else None

    @property
    def notes(self) -> list[str]:
        """The notes of the contact."""
        return self.contact.notes if self.contact else []

    def _bits(self, names: set[str]) -> int:
        # Almost always there are none.
        return sum(1 << place for place, name in enumerate(self.channels) if name in names) if names else 0


def snapshot(surface: Surface, now_s: float) -> Snapshot:
    """Return a surface as of `now_s` [s, monotonic]."""
    newest, outcome = surface.newest, _outcome(surface, now_s)
    is_current = isinstance(outcome, Contact) or outcome in {Kind.TOO_FEW_CHANNELS, Kind.UNUSABLE_ESTIMATE}
    return Snapshot(
        surface=surface,
        now_s=now_s,
        outcome=outcome,
        channels=surface.model.channels if surface.model else [],
        bad=newest.bad if is_current and newest else {},
        age_ms=newest.age_ms(now_s) if newest else None,
        sequence=newest.sample.sequence if newest else 0,
    )


def _outcome(surface: Surface, now_s: float) -> Contact | Kind:
    try:
        return surface.contact(now_s)
    except ProblemError as error:
        return error.problem.kind
