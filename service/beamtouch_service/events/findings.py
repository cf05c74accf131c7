"""Findings of the segmenter: commands for the store, and samples that late ones are decided with. Pure."""

from dataclasses import dataclass
from typing import NamedTuple

from beamtouch_models.modelfile import ModelFile, State
from beamtouch_service.events.captures import Capture
from beamtouch_service.events.segments import End, Segment
from beamtouch_service.surfaces.estimates import Estimated
from beamtouch_service.surfaces.follower import Past


@dataclass(frozen=True)
class Finish:
    """The event whose last sample has number `last_sequence` ended; `LIFT` says that a clear sample follows."""

    boot_id: str
    last_sequence: int
    end: End
    lifted_us: int | None = None


@dataclass(frozen=True)
class TouchSeen:
    """The event whose first sample has number `first_sequence` began there: the sample before was clear."""

    boot_id: str
    first_sequence: int


@dataclass(frozen=True)
class Loss:
    """A write for this surface was lost: its open event ends as unseen."""


class Edge(NamedTuple):
    """A sample next to a gap: late samples that fill the gap are decided from what it leaves."""

    boot_id: str
    model: str
    sequence: int
    acquired_us: int
    state: State | None
    """None if it is undecided, or depends on the samples before it."""
    past: Past

    @property
    def is_certain(self) -> bool:
        """Whether no sample before it can change its state. A stretch just before it could still go on."""
        return len(self.past.memories) == 1


class Doubtful(NamedTuple):
    """Samples at the beginning of a run, up to the first that does not depend on those before the run."""

    boot_id: str
    model: ModelFile
    samples: list[Estimated]


Command = Segment | Capture | Finish | TouchSeen | Loss | Edge
Found = Command | Doubtful
