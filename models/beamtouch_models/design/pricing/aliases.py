"""The modes of a beam that readings at one rate do not show as swings, and a rate at which they would.

Readings at a rate r see a mode of frequency f at the distance of f from the nearest multiple of r. Where that is so low
that the mode seems to stand still for `STILL_S`, its swing is taken for deflection: no filter tells them apart. A
sudden force excites mode k with a share of the deflection that falls as 1/k^4.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_common.digits import Rounded
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.motion import M_PER_MM, Modes, damping_of
from beamtouch_models.design.physics.solid import loads_of
from beamtouch_models.design.scene import Scene
from beamtouch_models.filters.sinusoids import LEAST_CYCLES

STILL_S = 0.1
"""Time for which a mode may seem to stand still."""
RATES = 0.7, 1.4
"""Rates that are compared, over the stated one."""
STEPS = 141
"""Number of rates: half a percent of the stated one apart."""
LEAST_UNSEEN = 0.01
"""Least swing that readings do not show, over that which they show: of modes that are neither slow nor large."""
USUAL = 1 / 2
"""Swing of an aliased mode under a usual load, over its largest."""


@dataclass(frozen=True, repr=False)
class Aliased(Rounded):
    """A mode that seems to stand still."""

    mode: int
    """1 is the slowest."""
    frequency_hz: float
    seen_hz: float
    """At what frequency readings see it."""
    swing_mm: float
    """Largest amplitude that the largest force leaves in it."""
    share: float
    """The same over that of the slowest mode."""
    lasts_s: float
    """Time until the readings show the swing, or it has fallen below the noise of a reading."""


def aliased_modes(scene: Scene, reading_mm: float) -> tuple[tuple[Aliased, ...], float | None]:
    """Return the modes that seem to stand still and swing by more than the noise of a reading, and a better rate.

    The rate is None if there are no such modes, if the mass of the beam is not stated, or if no rate nearby is better.
    """
    modes = Modes.of(scene.solid, scene.contact.width_mm)
    if modes is None or not reading_mm:
        return (), None
    shapes = modes.under(loads_of(scene)) ** 2
    swing_mm = (shapes * modes.square_s2).max(axis=0) * scene.contact.force_range_n[1] / M_PER_MM
    frequency_hz, rate_hz = 1 / (2 * math.pi * np.sqrt(modes.square_s2)), scene.sensors.rate_hz
    seen_hz = _seen_hz(frequency_hz, rate_hz)
    fall_per_s = 2 * math.pi * frequency_hz * damping_of(scene.solid)
    lasts_s = np.minimum(
        LEAST_CYCLES / np.maximum(seen_hz, 1e-9), np.log(np.maximum(swing_mm / reading_mm, 1.0)) / fall_per_s
    )
    unseen = np.flatnonzero((swing_mm > reading_mm) & (lasts_s > STILL_S))
    aliased = tuple(
        Aliased(
            mode=int(mode) + 1,
            frequency_hz=float(frequency_hz[mode]),
            seen_hz=float(seen_hz[mode]),
            swing_mm=float(swing_mm[mode]),
            share=float(swing_mm[mode] / swing_mm[0]),
            lasts_s=float(lasts_s[mode]),
        )
        for mode in unseen
    )
    return aliased, _better_hz(frequency_hz, swing_mm, rate_hz) if aliased else None


def unseen_swing(scene: Scene, reading_mm: float) -> float:
    """Return the swing of a beam that readings do not show, over that which they show; arguments as above."""
    return unseen_of(aliased_modes(scene, reading_mm)[0])


def unseen_of(aliased: Sequence[Aliased]) -> float:
    """Return the same for the modes that seem to stand still."""
    return min(1.0, LEAST_UNSEEN + USUAL * sum(mode.share for mode in aliased))


def at_rate(scene: Scene, rate_hz: float) -> Scene:
    """Return a scene that is read at another rate."""
    return scene.model_copy(update={"sensors": scene.sensors.model_copy(update={"rate_hz": rate_hz})})


def _seen_hz(frequency_hz: Floats, rate_hz: Floats | float) -> Floats:
    """Return at what frequencies readings see modes."""
    seen: Floats = np.abs(frequency_hz - np.rint(frequency_hz / rate_hz) * rate_hz)
    return seen


def _better_hz(frequency_hz: Floats, swing_mm: Floats, rate_hz: float) -> float | None:
    """Return the rate nearby at which least swing seems to stand still; None if that is the stated one."""
    rates = rate_hz * np.linspace(*RATES, STEPS)
    seen_hz = _seen_hz(frequency_hz, rates[:, np.newaxis])
    hidden = (swing_mm * np.exp(-((seen_hz * STILL_S / LEAST_CYCLES) ** 2))).sum(axis=1)
    # Of rates that hide about as little, the nearest.
    good = np.flatnonzero(hidden <= 1.1 * hidden.min())
    best = float(rates[good[np.abs(rates[good] - rate_hz).argmin()]])
    rounded = float(f"{best:.3g}")
    return None if math.isclose(rounded, rate_hz, rel_tol=0.01) else rounded
