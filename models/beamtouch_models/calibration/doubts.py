"""The search for what a recording itself may hide: a forgotten weight, and a channel whose characteristic is wrong.

Each is fitted beside all departures of the surface, and is named if the recording is much more probable with it, also
than with any single load that is mistyped.
"""

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.calibration.fit import Fit, fit
from beamtouch_models.calibration.mistaken import AGREED
from beamtouch_models.calibration.recordings import Loads
from beamtouch_models.calibration.session import WEIGHT, Session, bend_of
from beamtouch_models.calibration.theory import Theory

SURELY = 7.0
"""Gain of the logarithm of the probability from which something is named: a thousand to one."""
HARMLESS_NOISES = 8.0
"""Largest own bend, in noises of a sample, below which a channel does no harm."""
HARMLESS_WEIGHT = 0.02
"""Largest forgotten weight, over the mean force, that does no harm; forces are stated to about half as much."""


def doubt(theory: Theory, loads: Loads, names: list[str]) -> str | None:
    """Say what the loads hide: a channel that does not fit, or a forgotten weight; None if neither shows."""
    kinds = Session(theory, loads).usual_kinds
    plain = fit(theory, loads, kinds)
    suspects = [WEIGHT, *(bend_of(channel) for channel in range(len(names)))]
    best, hidden = plain, list[str]()
    while len(hidden) < len(suspects):
        trials = [fit(theory, loads, (*kinds, *hidden, one), best.vector) for one in suspects if one not in hidden]
        trial = max(trials, key=lambda one: one.log_evidence)
        if trial.log_evidence < best.log_evidence + SURELY:
            break
        best, hidden = trial, [*hidden, trial.kinds[-1]]
    if not hidden or best.scatter > AGREED or best.log_evidence < _with_a_mistyped_load(theory, loads, kinds):
        return None
    told = [text for one in hidden if (text := _in_words(best, one, names))]
    return "; ".join(told) + "; nothing was written" if told else None


def _with_a_mistyped_load(theory: Theory, loads: Loads, kinds: tuple[str, ...]) -> float:
    """Return the logarithm of the probability of the recording if its worst load may have any deflections."""
    anything = float(np.log(np.sqrt(np.nanmean(loads.measured_mm**2)))) + 0.5
    measured = np.isfinite(loads.measured_mm).sum(axis=1)
    each = [
        fit(theory, loads.without(index), kinds, rounds=2).log_evidence - anything * count
        for index, count in enumerate(measured.tolist())
    ]
    return max(each)


def _in_words(found: Fit, kind: str, names: list[str]) -> str:
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
    if abs(bends_mm[worst]) < HARMLESS_NOISES * found.theory.prior.noise_mm:
        return ""
    shown_mm = float(loads.measured_mm[worst, channel])
    return (
        f"{names[channel]} does not fit, as if its characteristic were another: where it shows {digits(shown_mm, 3)} mm, "
        f"the loads say {digits(shown_mm - float(bends_mm[worst]), 3)} mm. Check its table, or measure one with feeler "
        "gauges, and record the loads again"
    )
