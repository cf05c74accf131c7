"""The search for swapped cables, inverted sensors, and swapped ends or axes of the structure in a recording.

Cables that were swapped after the tare also move the zeros, by the difference of the two rest gaps. So each wiring is
tried with the zeros as tared, and with zeros of its own.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.fit import fit
from beamtouch_models.design.calibration.mistaken import AGREED
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import EXCHANGED, Loads, may_be_exchanged
from beamtouch_models.design.calibration.session import Session
from beamtouch_models.design.physics.structure import size_of
from beamtouch_models.runtime.decision.wrong_channels import wiring_faults

POOR_NOISES = 8.0
"""Residual, in noises of a sample, below which loads agree with the channels as they are."""
BETTER = 3.0
"""Factor by which the scatter must shrink when something is swapped."""
OTHER_END = (
    "the channels seem to be in reverse order, or positions to be measured from the other end of the beam; "
    "check the order in the daemon's config, and where positions are measured from"
)
"""One message for both: on a symmetric surface they look the same."""
OTHER_CORNER = (
    "the channels seem to be in another order, or x_mm and y_mm to be measured from another corner of the plate; "
    "check the order in the daemon's config, and where places are measured from"
)
"""The same of a plate."""
SINCE_THE_TARE = "tare with nothing on the beam, and record again"


def swapped(nominal: NominalSurface, loads: Loads, names: list[str]) -> str | None:
    """Say what seems swapped or inverted: channels, the order of all, the ends or the axes; None if nothing does.

    Zeros that moved since the tare are told, too: alone, or as the mark of cables that were swapped since then.
    """
    kinds = Session(nominal, loads).usual_kinds
    asis = fit(nominal, loads, kinds)
    # Few sensors under a plate see little that another place and force of each load would not explain.
    agree = nominal.prior.extent.axes == 1 or asis.scatter <= AGREED
    if agree and asis.errors.residual_mm <= POOR_NOISES * nominal.prior.errors.noise_mm:
        return None
    trials = [(fit(nominal, corrected, kinds).scatter, message) for message, corrected in _swaps(nominal, loads, names)]
    scatter, message = min(trials, default=(np.inf, ""))
    if BETTER * scatter < asis.scatter:
        return message
    moved_mm, from_zeros = _from_own_zeros(nominal, loads)
    rezeroed = fit(nominal, from_zeros, kinds).scatter
    trials = [
        (fit(nominal, _from_own_zeros(nominal, corrected)[1], kinds).scatter, message)
        for message, corrected in _swaps(nominal, loads, names)
    ]
    scatter, message = min(trials, default=(np.inf, ""))
    if BETTER * scatter < min(asis.scatter, rezeroed):
        return f"{message}; the zeros have moved, too, so {SINCE_THE_TARE}"
    if BETTER * rezeroed < asis.scatter and rezeroed <= AGREED:
        far = np.flatnonzero(np.abs(moved_mm) > POOR_NOISES * nominal.prior.errors.noise_mm).tolist()
        told = ", ".join(f"{names[channel]} by {digits(float(moved_mm[channel]), 2)} mm" for channel in far)
        return f"zeros have moved since the tare: {told}; {SINCE_THE_TARE}; nothing was written" if told else None
    return None


def _from_own_zeros(nominal: NominalSurface, loads: Loads) -> tuple[Floats, Loads]:
    """Return the zeros (channels,) that loads show by the scene, and the loads from these."""
    expected_mm = nominal.curve(np.zeros(nominal.size)).measured_mm(loads.place_mm, loads.force_n)
    zero_mm = np.zeros(len(expected_mm[0]))
    for channel, (measured, expected) in enumerate(zip(loads.measured_mm.T, expected_mm.T, strict=True)):
        there = np.isfinite(measured)
        if np.ptp(expected[there]) > 0:
            _, zero_mm[channel] = np.polyfit(expected[there], measured[there], 1)
    return zero_mm, replace(loads, measured_mm=loads.measured_mm - zero_mm)


def _swaps(nominal: NominalSurface, loads: Loads, names: list[str]) -> Iterator[tuple[str, Loads]]:
    """Yield each possible swap: its message, and the loads without the swap."""
    mirrored = OTHER_END if nominal.prior.extent.axes == 1 else OTHER_CORNER
    for wiring in wiring_faults(names):
        message = f"{wiring.text}; check the wiring and the order in the daemon's config"
        measured_mm = loads.measured_mm[:, wiring.order] * np.array(wiring.signs)
        deviation_mm = loads.deviation_mm[:, wiring.order]
        corrected = replace(loads, measured_mm=measured_mm, deviation_mm=deviation_mm)
        yield mirrored if wiring.is_reversed else message, corrected
    extent, size_mm = nominal.prior.extent, np.array(size_of(nominal.structure))
    if may_be_exchanged(extent, loads.place_mm):
        yield EXCHANGED, replace(loads, place_mm=loads.place_mm[:, ::-1])
    for axes in product((False, True), repeat=extent.axes):
        other_mm = np.where(axes, size_mm - loads.place_mm, loads.place_mm)
        if any(axes) and np.all((extent.low_mm <= other_mm) & (other_mm <= extent.high_mm)):
            yield mirrored, replace(loads, place_mm=other_mm)
