"""The search for channels, or ends of the beam, that were taken the wrong way round."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from beamtouch_models.calibration.fit import Theory, fit
from beamtouch_models.calibration.loads import Loads

POOR_NOISES = 8.0
"""Loads that leave less than this unexplained, in noises of a sample, agree with the channels as they are."""
BETTER = 3.0
"""Times by which the scatter must shrink when something is exchanged."""
OTHER_END = (
    "the channels seem to be in reverse order, or positions to be measured from the other end of the beam; "
    "check the order in the daemon's config, and where positions are measured from"
)
"""Both in one: on a symmetric surface they look the same."""


def swapped(theory: Theory, loads: Loads, names: list[str]) -> str | None:
    """Say what seems exchanged: two channels, all of them, or the ends of the beam; None where nothing does."""
    kinds = tuple(theory.kinds)
    asis = fit(theory, loads, kinds)
    if asis.unexplained_mm <= POOR_NOISES * theory.prior.noise_mm:
        return None
    trials = [(fit(theory, other, kinds).residual_mm, said) for said, other in _exchanged(theory, loads, names)]
    scatter, said = min(trials, default=(np.inf, ""))
    return said if BETTER * scatter < asis.residual_mm else None


def _exchanged(theory: Theory, loads: Loads, names: list[str]) -> Iterator[tuple[str, Loads]]:
    """What may have been exchanged, in words, with the loads put right."""
    count = len(names)
    for first, second in combinations(range(count), 2):
        order = list(range(count))
        order[first], order[second] = second, first
        said = f"{names[first]} and {names[second]} seem to be swapped"
        yield f"{said}; check their wiring and the order in the daemon's config", _ordered(loads, order)
    if count > 3:  # of fewer, a pair of them does it
        yield OTHER_END, _ordered(loads, list(range(count))[::-1])
    mirrored = theory.prior.length_mm - loads.position_mm
    low, high = theory.prior.position_mm
    if ((low <= mirrored) & (mirrored <= high)).all():
        yield OTHER_END, replace(loads, position_mm=mirrored)


def _ordered(loads: Loads, order: list[int]) -> Loads:
    return replace(loads, stated_mm=loads.stated_mm[:, order], deviation_mm=loads.deviation_mm[:, order])
