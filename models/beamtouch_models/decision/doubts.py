"""Doubts about a sample, from its evidence: odd, overload, unchecked. Pure."""

from beamtouch_models.decision.evidence import CHECKED, Evidence
from beamtouch_models.metadata import Metadata, Thresholds

SURELY = 2.0
"""The force is said to be beyond the range if it is so by more than this many half-widths of its interval."""


def is_odd(thresholds: Thresholds, evidence: Evidence) -> bool:
    """Return whether neither rest nor a single contact explains a sample."""
    place = evidence.channels - 1
    return evidence.rest_misfit > thresholds.rest[place] and evidence.misfit > thresholds.misfit[place]


def is_overload(metadata: Metadata, evidence: Evidence) -> bool:
    """Return whether the force of a contact is beyond the range of the scene; False for a model that states none."""
    force_n, low_n = (evidence.answer.get(name) for name in ("force_n", "force_low_n"))
    if force_n is None or low_n is None:
        return False
    return force_n - SURELY * (force_n - low_n) > metadata.ranges.force_n[1]


def is_unchecked(evidence: Evidence) -> bool:
    """Return whether so few channels took part that much else looks like a contact."""
    return evidence.channels < CHECKED
