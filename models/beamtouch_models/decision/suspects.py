"""Which single channel contradicts the others, found by leaving out each in turn. Pure but for the run of the graph."""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from beamtouch_models.decision.evidence import CHECKED, Evidence, Weighed, evidence
from beamtouch_models.metadata import Metadata
from beamtouch_models.session import Run

SAMPLES = 40
"""Samples that are asked about. One sample of two contacts may look like a wrong channel; many seldom agree on it."""
AGREEING = 0.9
"""Part of them that must name the same channel, and no other."""


class LeftOut(NamedTuple):
    """A sample without one of its channels."""

    misfit: float
    """How badly the best single contact explains what is left."""
    rest_misfit: float
    """How badly rest does."""
    explained: bool
    """Whether rest or a single contact explains what is left."""


class Suspects:
    """Keeps what the last unexplained samples say about single channels."""

    def __init__(self, metadata: Metadata, run: Run) -> None:
        self._metadata, self._run = metadata, run
        self._found: deque[str | None] = deque(maxlen=SAMPLES)
        self.without: dict[str, LeftOut] = {}
        """Channel -> the last sample without it; empty where fewer channels are left than check a contact."""

    def clear(self) -> None:
        """Forget the samples: the stretch that they belong to is over."""
        self._found.clear()
        self.without = {}

    def step(self, sample: Weighed) -> str | None:
        """Take the next unexplained sample, one row; return the name of the channel that contradicts the others."""
        self.without = self._leave_out(sample)
        explaining = [name for name, left in self.without.items() if left.explained]
        # If several would do, none of them is known to be wrong.
        self._found.append(explaining[0] if len(explaining) == 1 else None)
        if len(self._found) < SAMPLES:
            return None
        (name, count), *_ = Counter(self._found).most_common(1)
        return name if count >= AGREEING * SAMPLES else None

    def explained(self, found: Evidence) -> bool:
        """Return whether rest or a single contact explains a sample."""
        limits, place = self._metadata.thresholds, found.channels - 1
        return found.misfit <= limits.misfit[place] or found.rest_misfit <= limits.rest[place]

    def _leave_out(self, sample: Weighed) -> dict[str, LeftOut]:
        """Return what is left of a sample without each of its channels."""
        working = np.flatnonzero(sample.valid[0])
        if len(working) <= CHECKED:
            return {}
        names = [self._metadata.layout[channel].name for channel in working.tolist()]
        each = evidence(self._metadata, self._run, _stacked([sample.without(channel) for channel in working.tolist()]))
        return {
            name: LeftOut(found.misfit, found.rest_misfit, self.explained(found))
            for name, found in zip(names, each, strict=True)
        }


def _stacked(samples: Sequence[Weighed]) -> Weighed:
    """Return samples as one, so that the graph runs once."""
    return Weighed(*(np.concatenate([getattr(one, part.name) for one in samples]) for part in fields(Weighed)))
