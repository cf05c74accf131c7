"""The channels that are wrong: one that contradicts the others, and the wiring that several contacts show.

A channel that contradicts the others is found by leaving out each in turn. A contact that is measured through another
wiring (two cables swapped, a sensor inverted, all in reverse order) is unexplained, unless it fits some other contact
by chance. It is explained once its channels are put back. Other loads are so by chance, now and then; hardly ever three
at different places by the same wiring, with none between them that speaks against it. Pure but for the run of the
graph.
"""

from collections import Counter, deque
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from beamtouch_models.runtime.decision.evidence import Weighed, evidence, is_odd
from beamtouch_models.runtime.metadata import Metadata, fewest_that_check
from beamtouch_models.runtime.session import Run

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
    """True if rest or a single contact explains the sample."""


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
        explaining = [name for name, left_out in without.items() if left_out.explained]
        # If several would do, none of them is known to be wrong.
        self._found.append(explaining[0] if len(explaining) == 1 else None)
        (name, count), *_ = Counter(self._found).most_common(1)
        self.suspect = name if count >= AGREEING * SAMPLES else None

    def leave_out(self, samples: Weighed) -> list[dict[str, LeftOut]]:
        """Return the misfits of each sample without each of its channels.

        They are left out where the other channels are so few that they fit most contacts.
        """
        coarse, names = self._coarse(samples), [channel.name for channel in self._metadata.layout]
        left_out = list[dict[str, LeftOut]]({} for _ in samples.valid)
        fewest = fewest_that_check(len(self._metadata.axes))
        checked = samples.valid & (samples.valid.sum(axis=1, keepdims=True) > fewest)
        rows, channels = np.nonzero(checked)
        for begin in range(0, len(rows), ROWS):
            row, channel = rows[begin : begin + ROWS], channels[begin : begin + ROWS]
            evidences = evidence(self._metadata, self._run, coarse.part(row).without(channel))
            for index, place, said in zip(row.tolist(), channel.tolist(), evidences, strict=True):
                explained = not is_odd(self._metadata.thresholds, said)
                left_out[index][names[place]] = LeftOut(said.misfit, explained)
        return left_out

    def _coarse(self, samples: Weighed) -> Weighed:
        """Return samples with at least the noise that the model was made for.

        Two contacts may look like a single one without any of several channels. In a precise mean only one of these
        channels may be left, by chance, and none of them is wrong. So channels are left out at the model's own noise.
        """
        missing = np.maximum(self._metadata.noise.sample_mm**2 - samples.noise_mm2, 0.0)
        return replace(samples.noisier(missing), noise_mm2=samples.noise_mm2 + missing)


BETTER = 3.0
"""Factor by which errors must shrink when a wiring is put right; misfits shrink by its square."""
CONTACTS = 3
"""Number of contacts at different places that a wiring must explain, with none between them that it does not."""
OF_FEW = 5
"""The same with as few channels as can check a contact at all: more fits them by chance."""
APART = 0.1
"""Distance between different places, over the range of contacts. A load that always acts in the same way may fit a
wiring by chance again and again."""
MIRRORED = 2
"""Number of wirings that may be named together. On a symmetric surface, the swap of the outer two sensors looks like
that of the inner two, from the other end."""
GAIN = 0.03
"""Error of the gains that is allowed for, so that wirings are found on a surface that is not calibrated yet."""


class WiringFault(NamedTuple):
    """One fault of the wiring."""

    order: list[int]
    """Index of the channel that has the values of each sensor."""
    signs: list[float]
    """-1 for a sensor that is inverted."""
    text: str

    @property
    def is_reversed(self) -> bool:
        """True if all channels are in reverse order."""
        return len(self.order) > 3 and self.order == list(range(len(self.order)))[::-1]

    def corrected(self, sample: Weighed) -> Weighed:
        """Return samples (samples, channels) as they would be with the right wiring."""
        signs = np.array(self.signs)
        return Weighed(
            sample.deflection_mm[:, self.order] * signs,
            sample.covariance_mm2[:, self.order][:, :, self.order] * np.outer(signs, signs),
            sample.noise_mm2[:, self.order],
            sample.valid[:, self.order],
            sample.zero_mm2,
        )


def wiring_faults(names: list[str]) -> list[WiringFault]:
    """Return the faults that are looked for: two channels swapped, one inverted, all in reverse order."""
    asis = list(range(len(names)))
    right = [1.0] * len(names)
    candidates = []
    for first, second in combinations(asis, 2):
        order = asis.copy()
        order[first], order[second] = second, first
        candidates.append(WiringFault(order, right, f"{names[first]} and {names[second]} seem to be swapped"))
    for index in asis:
        signs = right.copy()
        signs[index] = -1.0
        candidates.append(WiringFault(asis, signs, f"{names[index]} seems to be inverted"))
    if len(names) > 3:  # the reverse order of fewer channels is the swap of two
        candidates.append(WiringFault(asis[::-1], right, "the channels seem to be in reverse order"))
    return candidates


class Wirings:
    """Finds the wiring that the contacts of one surface show."""

    def __init__(self, metadata: Metadata, run: Run) -> None:
        self._metadata, self._run = metadata, run
        names = [channel.name for channel in metadata.layout]
        fewest = fewest_that_check(len(metadata.axes))
        self._wirings = wiring_faults(names) if len(names) >= fewest else []
        self._contacts = CONTACTS if len(names) > fewest else OF_FEW
        self._places_mm = [list[float]() for _ in self._wirings]
        """Different places of the contacts that each wiring has explained since the last one that it did not."""
        low_mm, high_mm = metadata.ranges.position_mm
        self._apart_mm = APART * (high_mm - low_mm)
        self._output = f"{metadata.axes[0]}_mm"
        """Places differ if they do along the first axis."""
        self.finding: str | None = None
        """The wiring that explains the contacts so far, in words; None if there is none."""
        self._found = set[int]()

    def add(self, sample: Weighed) -> None:
        """Add one settled sample of a contact, with all channels."""
        if not self._wirings:
            return
        coarse = sample.noisier((GAIN * sample.deflection_mm) ** 2)
        corrected = [coarse, *(wiring.corrected(coarse) for wiring in self._wirings)]
        asis, *rewired = evidence(self._metadata, self._run, Weighed.stacked(corrected))
        odd = is_odd(self._metadata.thresholds, asis)
        for index, said in enumerate(rewired):
            places_mm = self._places_mm[index]
            if is_odd(self._metadata.thresholds, said):
                places_mm.clear()
                if index in self._found and not odd:
                    self._found, self.finding = set(), None
            elif odd and BETTER**2 * said.misfit <= asis.misfit:
                place_mm = said.answer[self._output]
                if all(abs(place_mm - other_mm) >= self._apart_mm for other_mm in places_mm):
                    places_mm.append(place_mm)
        if odd:
            self._decide()

    def _decide(self) -> None:
        enough = {index for index, places_mm in enumerate(self._places_mm) if len(places_mm) >= self._contacts}
        if 0 < len(enough) <= MIRRORED:
            self._found = enough
            self.finding = ", or ".join(self._wirings[index].text for index in sorted(enough))
