"""The search for swapped channels, an inverted one, and swapped ends of the beam."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from beamtouch_models.calibration.fit import fit
from beamtouch_models.calibration.loads import Loads
from beamtouch_models.calibration.theory import Theory
from beamtouch_models.decision import Wiring, wirings

POOR_NOISES = 8.0
"""Residual, in noises of a sample, below which loads agree with the channels as they are."""
BETTER = 3.0
"""Factor by which the scatter must shrink when something is swapped."""
OTHER_END = (
    "the channels seem to be in reverse order, or positions to be measured from the other end of the beam; "
    "check the order in the daemon's config, and where positions are measured from"
)
"""One message for both: on a symmetric surface they look the same."""


def swapped(theory: Theory, loads: Loads, names: list[str]) -> str | None:
    """Say what seems swapped or inverted: channels, the order of all, or the ends of the beam; None if nothing does."""
    kinds = tuple(theory.kinds)
    asis = fit(theory, loads, kinds)
    if asis.residual_mm <= POOR_NOISES * theory.prior.noise_mm:
        return None
    trials = [(fit(theory, other, kinds).scatter, message) for message, other in _swaps(theory, loads, names)]
    scatter, message = min(trials, default=(np.inf, ""))
    return message if BETTER * scatter < asis.scatter else None


def _swaps(theory: Theory, loads: Loads, names: list[str]) -> Iterator[tuple[str, Loads]]:
    """Yield each possible swap: its message, and the loads without the swap."""
    for wiring in wirings(names):
        message = f"{wiring.text}; check the wiring and the order in the daemon's config"
        yield OTHER_END if wiring.is_reversed else message, _corrected(loads, wiring)
    mirrored_mm = theory.prior.length_mm - loads.position_mm
    low, high = theory.prior.position_mm
    if ((low <= mirrored_mm) & (mirrored_mm <= high)).all():
        yield OTHER_END, replace(loads, position_mm=mirrored_mm)


def _corrected(loads: Loads, wiring: Wiring) -> Loads:
    measured_mm = loads.measured_mm[:, wiring.order] * np.array(wiring.signs)
    return replace(loads, measured_mm=measured_mm, deviation_mm=loads.deviation_mm[:, wiring.order])
