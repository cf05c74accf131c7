"""Ringing of the virtual surface after a change of load, all in the first mode, as the price of dynamics assumes."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.numbers import number, numbers
from beamtouch_models.physics import dynamics
from beamtouch_models.pricing.noise import MAX_DEFLECTION_MM
from beamtouch_models.scene import Scene
from beamtouch_models.surface import Surface

_GONE = 700.0
"""Time constants after which nothing of the ringing is left in float64."""


@dataclass(frozen=True)
class Mode:
    """A damped mode: y'' + 2 zeta w y' + w^2 y = w^2 s, for a deflection y that settles at the static one, s."""

    frequency_hz: float
    """w / (2 pi), without damping."""
    damping_ratio: float
    """zeta, between 0 and 1."""

    def after(self, seconds: float, static: Floats, deflection: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Return deflections and velocities after a time with constant static deflection.

        The exact solution, for any time (Blevins, Formulas for Natural Frequency and Mode Shape, 1979, ch. 2). All
        arrays have the shape (channels,), in mm and mm/s.
        """
        omega, zeta = 2 * math.pi * self.frequency_hz, self.damping_ratio
        if zeta * omega * seconds > _GONE:
            return static, np.zeros_like(static)
        damped = omega * math.sqrt(1 - zeta**2)
        decay = math.exp(-zeta * omega * seconds)
        cosine, sine = math.cos(damped * seconds), math.sin(damped * seconds)
        away = deflection - static
        later = decay * (away * cosine + (velocity + zeta * omega * away) / damped * sine)
        speed = decay * (velocity * cosine - (zeta * velocity + omega * away) * (omega / damped) * sine)
        return static + later, speed


class Ringing:
    """The motion of a surface, computed from one conversion to the next."""

    def __init__(self, mode: Mode) -> None:
        self._mode = mode
        self._last: tuple[float, Floats, Floats] | None = None

    def at(self, seconds: float, static: Floats) -> Floats:
        """Return the deflections (channels,) at a time [s] that is not before the last one.

        The load at a conversion is assumed to act since the previous conversion, so that a mode much faster than the
        conversions follows at once. At the first conversion the beam is at rest.
        """
        if self._last is None:
            self._last = (seconds, static, np.zeros_like(static))
        before, deflection, velocity = self._last
        deflection, velocity = self._mode.after(max(0.0, seconds - before), static, deflection, velocity)
        self._last = (seconds, deflection, velocity)
        return deflection


def ringing_of(surface: Surface, damping_ratio: float | None = None) -> Ringing | None:
    """Return the ringing of a surface, with the damping that its scene states or assumes unless another one is given.

    Returns
    -------
    None, and deflections follow at once, if the price of ringing behind the filter is negligible, or if the scene does
    not give density, width and thickness, which set the frequency.

    Raises
    ------
    SceneError
        A damping ratio is given, and the frequency is not known.
    """
    beam = surface.stated.beam
    frequency = dynamics.first_frequency_hz(beam)
    if frequency is None:
        if damping_ratio is None:
            return None
        message = (
            "damping_ratio needs beam.density_kg_m3 or beam.material, beam.width_mm and beam.thickness_mm in the scene"
        )
        raise SceneError(message)
    if any(effect.name == "dynamics" and effect.verdict == "out" for effect in surface.effects):
        return None
    return Ringing(Mode(frequency, dynamics.damping_of(beam) if damping_ratio is None else damping_ratio))


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
    """
    frequency_hz = dynamics.frequency_hz(scene)
    ratio = dynamics.damping_of(scene.beam) if damping_ratio is None else number(damping_ratio, "damping_ratio")
    if not 0 < ratio < 1:
        message = f"damping_ratio = {ratio:g} must be more than 0 and less than 1"
        raise SceneError(message)
    static = numbers(static_mm, "static_mm", least=-MAX_DEFLECTION_MM, most=MAX_DEFLECTION_MM)
    mode, rest, times = Mode(frequency_hz, ratio), np.zeros_like(static), numbers(time_s, "time_s", least=0.0)
    return np.array([mode.after(float(time), static, rest, rest)[0] for time in times])
