"""The search for what a recording itself may hide.

A weight or a shift that all loads have beyond what is stated, and a channel whose characteristic is wrong: each is
fitted beside all departures of the surface, and is named if the recording is much more probable with it, also than with
any single load that is mistyped.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.units import MM
from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.fit import Fit, fit
from beamtouch_models.design.calibration.mistaken import AGREED
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.calibration.session import COMMON, SHIFT, WEIGHT, Session, bend_of

SURELY, PERHAPS = 5.0, 1.0
"""Gain of the logarithm of the probability from which something is named, and from which it is fitted beside all else,
so that the errors of the fit hold it."""
MORE_FORCE, LESS_FORCE, MOVED, MOVED_ON_PLATE = (
    "as with a hanger or a pan that was not weighed",
    "as if the pan had lain on the {} at the tare, or the zero of the scale were off",
    "as if position_mm were not measured from the left end of the beam",
    "as if x_mm and y_mm were not measured from the lower left corner of the plate",
)
HARMLESS_BEND, HARMLESS_NOISES = 0.03, 2.0
"""Largest own bend that does no harm: relative to the largest deflection of the channel, and in noises of a sample."""


@dataclass(frozen=True)
class Doubts:
    """Doubts about a recording: effects that it would hide."""

    refusal: str = ""
    """Names a channel that does not fit; empty if none shows."""
    kinds: tuple[str, ...] = ()
    """Kinds that show beside the departures of the surface and are to be fitted, too."""
    sure: tuple[str, ...] = ()
    """Those of them that surely are there."""


def doubts(nominal: NominalSurface, loads: Loads, names: list[str]) -> Doubts:
    """Find what the loads hide: a weight or a shift of all of them, or a channel that does not fit."""
    kinds = Session(nominal, loads).usual_kinds
    plain = fit(nominal, loads, kinds)
    suspects = [*COMMON, *(bend_of(channel) for channel in range(len(names)))]
    best, hidden, gains = plain, list[str](), list[float]()
    while len(hidden) < len(suspects):
        trials = [
            fit(nominal, loads, (*kinds, *hidden, suspect), best.vector)
            for suspect in suspects
            if suspect not in hidden
        ]
        trial = max(trials, key=lambda candidate: candidate.log_evidence)
        gain = trial.log_evidence - best.log_evidence
        if gain < PERHAPS:
            break
        best, hidden, gains = trial, [*hidden, trial.kinds[-1]], [*gains, gain]
    if not hidden or best.scatter > AGREED or best.log_evidence < _with_a_mistyped_load(nominal, loads, kinds):
        return Doubts()
    sure = tuple(kind for kind, gain in zip(hidden, gains, strict=True) if gain >= SURELY)
    told = [_bend_in_words(best, kind, names) for kind in sure if kind not in COMMON]
    told = [text for text in told if text]
    return Doubts("; ".join([*told, "nothing was written"]) if told else "", tuple(hidden), sure)


def _with_a_mistyped_load(nominal: NominalSurface, loads: Loads, kinds: tuple[str, ...]) -> float:
    """Return the logarithm of the probability of the recording if its worst load may have any deflections."""
    anything = float(np.log(np.sqrt(np.nanmean(loads.measured_mm**2)))) + 0.5
    measured = np.isfinite(loads.measured_mm).sum(axis=1)
    log_evidences = [fit(nominal, loads.without(index), kinds, rounds=2).log_evidence for index in range(len(measured))]
    return float((np.array(log_evidences) - anything * measured).max())


def common_in_words(found: Fit, sure: tuple[str, ...]) -> dict[str, str]:
    """Return what all loads have beyond what is stated, by what it is of: "forces" and "places"; empty if nothing."""
    told, session = {}, found.session
    for kind, of in ((WEIGHT, "forces"), (SHIFT, "places")):
        if kind in found.kinds:
            what = _weight_in_words(found) if kind == WEIGHT else _shift_in_words(session, found.vector, found.spread)
            told[of] = f"{'' if kind in sure else 'perhaps '}{what}; the fit allows for it"
    return told


def _weight_in_words(found: Fit) -> str:
    value, error = found.session.weight_n(found.vector), found.session.weight_n(found.spread)
    size = f"{digits(abs(value), 3)} +- {digits(error, 2)} N"
    if value < 0:
        what = "beam" if found.nominal.prior.extent.axes == 1 else "plate"
        return f"each load presses with {size} less than stated, {LESS_FORCE.format(what)}"
    return f"each load presses with {size} more than stated, {MORE_FORCE}"


def _shift_in_words(session: Session, vector: Floats, spread: Floats) -> str:
    sides = [("left", "right"), ("down", "up")]
    told = [
        f"{digits(abs(value), 3)} +- {digits(error, 2)} mm farther {side[value > 0]}"
        for side, value, error in zip(
            sides, session.shift_mm(vector).tolist(), session.shift_mm(spread).tolist(), strict=False
        )
    ]
    return f"each load stands {' and '.join(told)} than stated, {MOVED if len(told) == 1 else MOVED_ON_PLATE}"


def _bend_in_words(found: Fit, kind: str, names: list[str]) -> str:
    """Return which channel does not fit and what to do about it; empty if it does no harm."""
    session, loads = found.session, found.session.loads
    channel = int(kind.removeprefix("bend "))
    bends_mm = session.bends_mm(found.vector)[:, channel]
    worst = int(np.nanargmax(np.abs(bends_mm)))
    shown_mm = float(loads.measured_mm[worst, channel])
    least_mm = max(HARMLESS_NOISES * found.nominal.prior.errors.noise_mm, HARMLESS_BEND * abs(shown_mm))
    if abs(bends_mm[worst]) < least_mm:
        return ""
    unit, shown, said = found.nominal.unit, digits(shown_mm, 3), digits(shown_mm - float(bends_mm[worst]), 3)
    measure = "measure one with feeler gauges" if unit == MM else "measure one"
    return (
        f"{names[channel]} does not fit, as if its characteristic were another: where it shows {shown} {unit}, the "
        f"loads say {said} {unit}. Check its table, or {measure}, and record the loads again"
    )
