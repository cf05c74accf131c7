"""The time for which a beam rings after a touch and after a lift.

A load that comes or goes at once leaves the lowest mode swinging about the new deflection, with an amplitude of the
load's whole deflection over sqrt(1 - zeta^2) at first and of exp(-zeta omega t) of that after a time t (Blevins,
Formulas for Natural Frequency and Mode Shape, 1979, ch. 2). It is gone when it is under the noise. Both are at their
worst: the largest force, where the beam yields most. A weight that lies on the beam swings with it and makes it slower.
A hand that pushes does not. So a touch rings at any frequency between that of the beam with the largest force as a
weight and that of the bare beam.
"""

import math
from dataclasses import dataclass
from typing import Literal

from numpy.typing import ArrayLike

from beamtouch_common.digits import Rounded, digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.motion import damping_of, first_frequency_hz, frequency_hz, laden_period_s, swing
from beamtouch_models.design.pricing.aliases import Aliased, aliased_modes, at_rate, unseen_of, unseen_swing
from beamtouch_models.design.pricing.noise import MAX_DEFLECTION_MM
from beamtouch_models.design.scene import Scene
from beamtouch_models.errors import SceneError
from beamtouch_models.numbers import number, numbers

ASSUMED = "assumed; with a tenth of it, it rings ten times as long: measure it, and state {}.damping_ratio"


@dataclass(frozen=True, repr=False)
class Ringing(Rounded):
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
    damping_is_assumed: bool
    """True if the scene states no damping; all times are inversely proportional to it."""
    aliased: tuple[Aliased, ...]
    """Modes that seem to stand still to readings at the rate of the scene."""
    better_rate_hz: float | None
    """A rate nearby at which fewer do; None if there are none, or no better rate."""
    unseen_swing: float
    """Swing that readings do not show, over that which they show; intervals allow for it while the beam rings."""
    better_unseen_swing: float | None
    """The same at the better rate."""


def ringing_of(scene: Scene, reading_mm: float, deflection_mm: float) -> Ringing | None:
    """Return the ringing of a scene; None if it does not give density, width and thickness.

    `reading_mm` is the noise of a reading, `deflection_mm` the largest deflection.

    Raises
    ------
    SceneError
        The frequency or the deflection cannot be computed.
    """
    frequency_hz, laden_s = first_frequency_hz(scene.solid), laden_period_s(scene)
    if frequency_hz is None or laden_s is None:
        return None
    damping_ratio, laden_hz = damping_of(scene.solid), 1 / laden_s
    aliased, better_rate_hz = aliased_modes(scene, reading_mm)
    return Ringing(
        frequency_hz=frequency_hz,
        laden_frequency_hz=laden_hz,
        damping_ratio=damping_ratio,
        after_touch_s=decay_s(deflection_mm / reading_mm, laden_hz, damping_ratio),
        after_lift_s=decay_s(deflection_mm / reading_mm, frequency_hz, damping_ratio),
        damping_is_assumed=scene.solid.damping_ratio is None,
        aliased=aliased,
        better_rate_hz=better_rate_hz,
        unseen_swing=unseen_of(aliased),
        better_unseen_swing=better_rate_hz and unseen_swing(at_rate(scene, better_rate_hz), reading_mm),
    )


def decay_s(ratio: float, frequency_hz: float, damping_ratio: float) -> float:
    """Return the time in which a load that comes at once rings down to the `ratio`-th part of its deflection, at most.

    0 if the ratio is below 1. Strong damping makes the sum of both parts of the motion larger than the deflection.
    """
    amplitude = max(ratio, 1.0) / math.sqrt(1 - damping_ratio**2) if ratio > 1 else 1.0
    return math.log(amplitude) / (damping_ratio * 2 * math.pi * frequency_hz)


def describe_ringing(found: Ringing, what: Literal["beam", "plate"]) -> list[str]:
    """Return the ringing in words, one line each."""
    assumed = f" ({ASSUMED.format(what)})" if found.damping_is_assumed else ""
    return [
        f"the {what} rings at {digits(found.frequency_hz, 3)} Hz, with the largest force lying on it as a weight at "
        f"{digits(found.laden_frequency_hz, 3)} Hz; damping {digits(100 * found.damping_ratio, 2)} % of "
        f"critical{assumed}",
        f"after a touch it rings for up to {digits(found.after_touch_s, 2)} s, after a lift for up to "
        f"{digits(found.after_lift_s, 2)} s, until the ringing is under the noise of a reading",
        "meanwhile answers come all the same: the filter follows the swings once the readings show them, and until "
        "then intervals are as wide as the swings make them",
        *map(_told_of, found.aliased),
        *_told_of_rates(found, what),
    ]


def _told_of_rates(found: Ringing, what: str) -> list[str]:
    """Return what modes that seem to stand still cost, and at what rate it is less, one line each."""
    if not found.aliased:
        return []
    share = digits(100 * found.unseen_swing, 2)
    cost = f"while the {what} rings, intervals therefore allow for {share} % of its swing"
    if found.better_rate_hz is None or found.better_unseen_swing is None:
        return [cost]
    less = digits(100 * found.better_unseen_swing, 2)
    return [cost, f"at {found.better_rate_hz:g} readings a second, less seems to stand still: {less} % of the swing"]


def _told_of(one: Aliased) -> str:
    """Return a mode that seems to stand still in words."""
    what = f"mode {one.mode}, of {digits(one.frequency_hz, 3)} Hz, looks like {digits(one.seen_hz, 2)} Hz"
    return (
        f"{what} to the readings: for up to {digits(one.lasts_s, 2)} s after a sudden force its swing, up to "
        f"{digits(one.swing_mm, 2)} mm, is taken for deflection"
    )


def ringing_mm(scene: Scene, static_mm: ArrayLike, time_s: ArrayLike, *, damping_ratio: float | None = None) -> Floats:
    """Return the deflections after a sudden load, which rings in the first mode of the beam.

    Parameters
    ----------
    scene : the scene
    static_mm : (sensors,) deflections once the beam has come to rest
    time_s : (times,) since the load acts, 0 or more
    damping_ratio : of the first mode, between 0 and 1; default: that of the scene, or 0.01

    Returns
    -------
    (times, sensors) in mm. Errors as `frequency_hz`.

    Examples
    --------
    >>> ringing_mm(scene, [1.0], [0.01, 10]).round(2)
    array([[1.9],
           [1. ]])
    """
    omega = 2 * math.pi * frequency_hz(scene)
    ratio = damping_of(scene.solid) if damping_ratio is None else number(damping_ratio, "damping_ratio")
    if not 0 < ratio < 1:
        raise SceneError(f"damping_ratio = {ratio:g} must be more than 0 and less than 1")
    static = numbers(static_mm, "static_mm", least=-MAX_DEFLECTION_MM, most=MAX_DEFLECTION_MM)
    moved = 1 + swing(numbers(time_s, "time_s", least=0.0), omega, ratio)
    return moved[:, None] * static
