"""How long a beam rings after a touch and after a lift, and when the first sharp answer comes.

A load that comes or goes at once leaves the lowest mode swinging about the new deflection, with an amplitude of the
load's whole deflection at first and of exp(-zeta omega t) of it after a time t (Blevins, Formulas for Natural Frequency
and Mode Shape, 1979, ch. 2). It is gone when it is under the noise. Both are at their worst: the largest force, where
the beam yields most. A weight that lies on the beam swings with it and makes it slower.
"""

import math
from dataclasses import dataclass

from beamtouch_models.metadata import FilterChoice
from beamtouch_models.physics.beam import max_deflection_mm
from beamtouch_models.physics.dynamics import damping_of, first_frequency_hz, laden_period_s, ringing_after_filter
from beamtouch_models.pricing.noise import noise_of
from beamtouch_models.scene import Scene


@dataclass(frozen=True)
class Ringing:
    """The ringing of a scene's beam."""

    frequency_hz: float
    """Lowest natural frequency of the bare beam."""
    laden_frequency_hz: float
    """The same with the largest force lying on it as a weight, where the beam yields most; never too high."""
    damping_ratio: float
    after_touch_s: float
    """Time from the touch of that weight until the ringing is under the noise of a reading."""
    after_lift_s: float
    """The same from its lift."""
    sharp_answer_s: float
    """Time from that touch until the ringing left in a settled sample is under the noise of the sample: from then on
    an answer has the accuracy that the model is made for. Before, its interval is as wide as the readings scatter."""


def ringing_of(scene: Scene, chosen: FilterChoice) -> Ringing | None:
    """Return the ringing of a scene behind a filter; None if it does not give density, width and thickness.

    Raises
    ------
    SceneError
        The frequency or the deflection cannot be computed.
    """
    frequency_hz, laden_s = first_frequency_hz(scene.beam), laden_period_s(scene)
    if frequency_hz is None or laden_s is None:
        return None
    noise, damping_ratio = noise_of(scene, chosen), damping_of(scene.beam)
    deflection_mm, laden_hz = max_deflection_mm(scene), 1 / laden_s
    left = ringing_after_filter(laden_hz, damping_ratio, chosen, scene.sensors.rate_hz)
    settled_s = chosen.settling_ms / 1000
    return Ringing(
        frequency_hz=frequency_hz,
        laden_frequency_hz=laden_hz,
        damping_ratio=damping_ratio,
        after_touch_s=decay_s(deflection_mm / noise.reading_mm, laden_hz, damping_ratio),
        after_lift_s=decay_s(deflection_mm / noise.reading_mm, frequency_hz, damping_ratio),
        sharp_answer_s=settled_s + decay_s(left * deflection_mm / noise.sample_mm, laden_hz, damping_ratio),
    )


def decay_s(ratio: float, frequency_hz: float, damping_ratio: float) -> float:
    """Return the time in which an oscillation decays to the `ratio`-th part of its amplitude; 0 if it is below 1."""
    return math.log(max(ratio, 1.0)) / (damping_ratio * 2 * math.pi * frequency_hz)


def told(found: Ringing) -> list[str]:
    """Return the ringing in words, one line each."""
    return [
        f"the beam rings at {found.frequency_hz:.3g} Hz, with the largest force lying on it as a weight at "
        f"{found.laden_frequency_hz:.3g} Hz; damping {100 * found.damping_ratio:.2g} % of critical",
        f"after a touch it rings for {found.after_touch_s:.2g} s, after a lift for {found.after_lift_s:.2g} s, until "
        "the ringing is under the noise of a reading",
        f"the first sharp answer comes {found.sharp_answer_s:.2g} s after such a touch at the latest; before, the "
        "interval is as wide as the readings scatter",
    ]
