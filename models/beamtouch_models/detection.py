"""Contacts that are missed along the beam, at the threshold of touch of a model.

A contact moves a whitened sample by a vector whose length is its force times the influence over the errors at rest. It
is seen when it passes the threshold in its own direction, so its margin over the smallest force that is seen in 95 of
100 samples says how often noise takes it below: missed = Phi(-1.645 - (force - smallest) |influence / errors|). Noise
in other directions adds a little to the odds of a contact, so that slightly fewer are missed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import erfc, sqrt

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.error_model import variance_mm2
from beamtouch_models.metadata import Metadata, SmallestForce

SURELY = 1.645
"""Deviations of a sample that a force must exceed the threshold by, so that 95 % of the samples do."""


@dataclass(frozen=True)
class Detection:
    """What a settled sample shows along the beam, with all channels."""

    position_mm: list[float]
    smallest_force_n: list[float | None]
    """95 of 100 settled samples at this force are a contact; None: nothing is seen."""
    force_n: float
    """Smallest force of the scene."""
    missed: list[float]
    """Share of settled samples at that force that are not a contact."""
    false_contacts_per_day: float
    """At rest, as designed."""


def detection(seen: SmallestForce, force_n: float, size_per_n: Floats, false_contacts_per_day: float) -> Detection:
    """Return what is seen along the beam, from the smallest forces and the length of the whitened influence there."""
    missed = missed_shares(force_n, seen.force_n, size_per_n)
    return Detection(seen.position_mm, seen.force_n, force_n, missed, false_contacts_per_day)


def extremes(smallest_n: Sequence[float | None]) -> tuple[float | None, float | None]:
    """Return the least and the largest of smallest forces; None, where nothing is seen, is larger than any."""
    seen = [force for force in smallest_n if force is not None]
    return min(seen, default=None), max(seen, default=None) if len(seen) == len(smallest_n) else None


def missed_shares(force_n: float, smallest_n: Sequence[float | None], size_per_n: Floats) -> list[float]:
    """Return the share of settled samples of a force that are not a contact, along the beam (positions,).

    Parameters
    ----------
    force_n : the force
    smallest_n : (positions,) force of which 95 % are seen; None where nothing is seen
    size_per_n : (positions,) length of the whitened influence, in deviations per newton
    """
    return [
        1.0 if smallest is None else erfc((SURELY + (force_n - smallest) * size) / sqrt(2)) / 2
        for smallest, size in zip(smallest_n, size_per_n.tolist(), strict=True)
    ]


def detection_of(metadata: Metadata) -> Detection:
    """Return what a model sees along the beam."""
    seen, floor = metadata.smallest_force, metadata.floor
    rest = np.sqrt(variance_mm2(0.0, metadata.noise.sample_mm, floor.gain, floor.zero_mm))
    size = np.linalg.norm(np.array(metadata.influence.mm_per_n) / rest, axis=1)
    at = np.linspace(*metadata.ranges.position_mm, len(size))
    size_there = np.interp(seen.position_mm, at, size)
    return detection(seen, metadata.ranges.force_n[0], size_there, metadata.thresholds.false_contacts_per_day)
