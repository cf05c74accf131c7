"""Which single channel contradicts the others, found by leaving out each in turn. Pure but for the run of the graph."""

from collections import deque

import numpy as np

from beamtouch_models.decision.evidence import Weighed, evidence
from beamtouch_models.metadata import Metadata
from beamtouch_models.session import Run

SAMPLES = 40
"""Samples that are asked about. One sample of two contacts may look like a wrong channel; many seldom agree on it."""
AGREEING = 0.9
"""Part of them that must name the same channel, and no other."""


class Suspects:
    """Keeps what the last unexplained samples say about single channels."""

    def __init__(self, metadata: Metadata, run: Run) -> None:
        self._metadata, self._run = metadata, run
        self._found: deque[int | None] = deque(maxlen=SAMPLES)

    def clear(self) -> None:
        """Forget the samples: the stretch that they belong to is over."""
        self._found.clear()

    def step(self, sample: Weighed) -> str | None:
        """Take the next unexplained sample, one row; return the name of the channel that contradicts the others."""
        self._found.append(self._only_suspect(sample))
        if len(self._found) < SAMPLES:
            return None
        named = [index for index in set(self._found) if index is not None]
        for index in named:
            if self._found.count(index) >= AGREEING * SAMPLES:
                return self._metadata.layout[index].name
        return None

    def _only_suspect(self, sample: Weighed) -> int | None:
        """Return the channel without which rest or one contact explains the sample; None for none, or several."""
        working = np.flatnonzero(sample.valid[0])
        limits, left = self._metadata.thresholds, len(working) - 1
        limit = limits.misfit[left - 1] if left > 0 else None
        if limit is None:
            return None
        suspects = []
        for channel in working.tolist():
            (found,) = evidence(self._metadata, self._run, sample.without(channel))
            if found.misfit <= limit or found.rest_misfit <= limits.rest[left - 1]:
                suspects.append(channel)
        return suspects[0] if len(suspects) == 1 else None
