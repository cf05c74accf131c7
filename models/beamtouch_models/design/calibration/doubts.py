"""The search for what a recording itself may hide: a forgotten weight, and a channel whose characteristic is wrong.

Each is fitted beside all departures of the surface, and is named if the recording is much more probable with it, also
than with any single load that is mistyped.
"""

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.design.calibration.fit import Fit, fit
from beamtouch_models.design.calibration.mistaken import AGREED
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.calibration.session import WEIGHT, Session, bend_of

SURELY, PERHAPS = 5.0, 1.0
"""Gain of the logarithm of the probability from which something is named, and from which it is fitted beside all else,
so that the errors of the fit hold it."""
HARMLESS_BEND, HARMLESS_NOISES = 0.03, 2.0
"""Largest own bend that does no harm: relative to the largest deflection of the channel, and in noises of a sample."""
HARMLESS_WEIGHT = 0.02
"""Largest forgotten weight, over the mean force, that does no harm; forces are stated to about half as much."""


def doubts(nominal: NominalSurface, loads: Loads, names: list[str]) -> tuple[str, tuple[str, ...]]:
    """Say what the loads hide: a channel that does not fit, or a forgotten weight; empty if neither shows.

    Returns its words, and the kinds of what shows and does no harm: these are to be fitted, too.
    """
    kinds = Session(nominal, loads).usual_kinds
    plain = fit(nominal, loads, kinds)
    suspects = [WEIGHT, *(bend_of(channel) for channel in range(len(names)))]
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
        return "", ()
    told = [in_words(best, kind, names) for kind, gain in zip(hidden, gains, strict=True) if gain >= SURELY]
    told = [text for text in told if text]
    return ("; ".join(told) + "; nothing was written", ()) if told else ("", tuple(hidden))


def _with_a_mistyped_load(nominal: NominalSurface, loads: Loads, kinds: tuple[str, ...]) -> float:
    """Return the logarithm of the probability of the recording if its worst load may have any deflections."""
    anything = float(np.log(np.sqrt(np.nanmean(loads.measured_mm**2)))) + 0.5
    measured = np.isfinite(loads.measured_mm).sum(axis=1)
    log_evidences = [fit(nominal, loads.without(index), kinds, rounds=2).log_evidence for index in range(len(measured))]
    return float((np.array(log_evidences) - anything * measured).max())


def in_words(found: Fit, kind: str, names: list[str]) -> str:
    """Return what is hidden and what to do about it; empty if it does no harm."""
    session, loads = found.session, found.session.loads
    place = session.kinds[kind]
    if kind == WEIGHT:
        weight_n = session.weight_n(found.vector)
        error_n = session.weight_unit_n * float(found.spread[place][0])
        if abs(weight_n) < HARMLESS_WEIGHT * loads.force_n.mean():
            return ""
        if weight_n < 0:
            return (
                f"each load seems to press with {digits(-weight_n, 2)} +- {digits(error_n, 1)} N less than it states; "
                "check the scale, its zero and force_n of all loads"
            )
        return (
            f"each load seems to press with {digits(weight_n, 2)} +- {digits(error_n, 1)} N more than it states, as "
            "with a hanger or a tray that was not weighed; add its weight to force_n of each load"
        )
    channel = int(kind.removeprefix("bend "))
    bends_mm = session.bends_mm(found.vector)[:, channel]
    worst = int(np.nanargmax(np.abs(bends_mm)))
    shown_mm = float(loads.measured_mm[worst, channel])
    least_mm = max(HARMLESS_NOISES * found.nominal.prior.errors.noise_mm, HARMLESS_BEND * abs(shown_mm))
    if abs(bends_mm[worst]) < least_mm:
        return ""
    return (
        f"{names[channel]} does not fit, as if its characteristic were another: where it shows {digits(shown_mm, 3)} "
        f"mm, the loads say {digits(shown_mm - float(bends_mm[worst]), 3)} mm. Check its table, or measure one with "
        "feeler gauges, and record the loads again"
    )
