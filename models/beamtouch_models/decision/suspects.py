"""The channel that contradicts the others, found by leaving out each in turn. Pure but for the run of the graph."""

from collections import Counter, deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from beamtouch_models.decision.evidence import CHECKED, Weighed, evidence, is_odd
from beamtouch_models.metadata import Metadata
from beamtouch_models.session import Run

SAMPLES = 40
"""Number of samples that count. One sample of two contacts may look like a wrong channel; many seldom agree on it."""
ROWS = 256
"""Rows in one run of the graph. More would cost memory and save no time."""
AGREEING = 0.9
"""Part of them that must name the same channel, and no other."""


class LeftOut(NamedTuple):
    """A sample without one of its channels."""

    misfit: float
    """Misfit of the best single contact."""
    explained: bool
    """Whether rest or a single contact explains the sample."""


class Suspects:
    """The suspects of the last unexplained samples, and the channel on which they agree."""

    def __init__(self, metadata: Metadata, run: Run) -> None:
        self._metadata, self._run = metadata, run
        self._found: deque[str | None] = deque(maxlen=SAMPLES)
        self.suspect: str | None = None
        """The channel that contradicts the others, as far as the samples so far say."""

    def clear(self) -> None:
        """Forget the samples: the stretch that they belong to is over, or other channels take part."""
        self._found.clear()
        self.suspect = None

    def add(self, without: dict[str, LeftOut]) -> None:
        """Add an unexplained sample without each of its channels."""
        explaining = [name for name, left in without.items() if left.explained]
        # If several would do, none of them is known to be wrong.
        self._found.append(explaining[0] if len(explaining) == 1 else None)
        (name, count), *_ = Counter(self._found).most_common(1)
        self.suspect = name if count >= AGREEING * SAMPLES else None

    def leave_out(self, samples: Weighed) -> list[dict[str, LeftOut]]:
        """Return the misfits of each sample without each of its channels.

        They are left out where the other channels are so few that they fit most contacts.
        """
        coarse, names = self._coarse(samples), [channel.name for channel in self._metadata.layout]
        found = list[dict[str, LeftOut]]({} for _ in samples.valid)
        checked = samples.valid & (samples.valid.sum(axis=1, keepdims=True) > CHECKED)
        rows, channels = np.nonzero(checked)
        for begin in range(0, len(rows), ROWS):
            row, channel = rows[begin : begin + ROWS], channels[begin : begin + ROWS]
            each = evidence(self._metadata, self._run, coarse.part(row).without(channel))
            for index, place, said in zip(row.tolist(), channel.tolist(), each, strict=True):
                explained = not is_odd(self._metadata.thresholds, said)
                found[index][names[place]] = LeftOut(said.misfit, explained)
        return found

    def _coarse(self, samples: Weighed) -> Weighed:
        """Return samples with at least the noise that the model was made for.

        Two contacts may look like a single one without any of several channels. In a precise mean only one of these
        channels may be left, by chance, and none of them is wrong. So channels are left out at the model's own noise.
        """
        missing = np.maximum(self._metadata.noise.sample_mm**2 - samples.noise_mm2, 0.0)
        return replace(samples.noisier(missing), noise_mm2=samples.noise_mm2 + missing)
