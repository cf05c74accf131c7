"""The search for two channels whose wires or names are swapped."""

from dataclasses import replace
from itertools import combinations

from beamtouch_models.calibration.fit import Theory, fit
from beamtouch_models.calibration.loads import Loads

POOR_NOISES = 8.0
"""Residual, in noises of a sample, below which loads agree with the channels as they are."""
BETTER = 3.0
"""Factor by which the scatter must shrink when the two channels are swapped."""


def swapped(theory: Theory, loads: Loads) -> tuple[int, int] | None:
    """Return the two channels that make the loads agree when swapped; None if there are none."""
    kinds = tuple(theory.kinds)
    asis = fit(theory, loads, kinds)
    if asis.residual_mm <= POOR_NOISES * theory.prior.noise_mm:
        return None
    scatter = {}
    for pair in combinations(range(len(theory.sensor_mm)), 2):
        order = list(range(len(theory.sensor_mm)))
        order[pair[0]], order[pair[1]] = pair[1], pair[0]
        other = replace(loads, stated_mm=loads.stated_mm[:, order], deviation_mm=loads.deviation_mm[:, order])
        scatter[pair] = fit(theory, other, kinds).scatter_mm
    if not scatter:
        return None
    best = min(scatter, key=scatter.__getitem__)
    return best if BETTER * scatter[best] < asis.scatter_mm else None
