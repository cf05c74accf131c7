"""An effect with its price, and the data that effects are priced with; `effects` decides which are modelled."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.physics.beam import load_positions_mm, scene_influence
from beamtouch_models.scene import Scene

Verdict = Literal["in", "out", "floor", "not stated", "not modelled"]

NEGLIGIBLE = 0.1
"""Price, in units of the noise, below which effects are left out."""


@dataclass(frozen=True)
class Effect:
    """An effect, priced for a scene."""

    name: str
    price: float | None
    """In units of the noise of a sample; None if the scene does not state the data for it."""
    verdict: Verdict
    """"in" or "out" of the influence matrix; "floor": part of the covariance of every sample; "not modelled": it
    matters, but no part of the model can include it."""
    reason: str
    having: Scene | None = None
    lacking: Scene | None = None
    """The scene with and without the effect, if the two differ."""
    leave_out: Callable[[Scene], Scene] | None = None
    """Removes the effect from a scene; None if that changes nothing."""


@dataclass(frozen=True)
class Pricing:
    """The data for pricing the effects of a scene."""

    scene: Scene
    filter: FilterChoice
    noise_mm: float
    """Noise of a sample behind the filter."""
    sensor_mm: Floats

    def deflection_mm(self, scene: Scene) -> Floats:
        """Return the deflection (loads, sensors) at the largest force."""
        return scene.contact.force_range_n[1] * scene_influence(scene, self.sensor_mm, load_positions_mm(scene))

    def price(self, having: Scene, lacking: Scene) -> float:
        """Return the largest difference in deflection between two scenes, in units of the noise."""
        return self.in_noise(self.deflection_mm(having) - self.deflection_mm(lacking))

    def in_noise(self, deflection_mm: Floats) -> float:
        """Return the largest deflection in units of the noise; raises SceneError beyond the range of float64."""
        with np.errstate(over="ignore"):
            price = float(np.abs(deflection_mm).max(initial=0.0) / self.noise_mm)
        if not math.isfinite(price):
            message = "sensors: the noise is too small next to the deflection to price effects in; state a larger one"
            raise SceneError(message)
        return price


def verdict_of(price: float) -> Verdict:
    """Return whether an effect with this price is in the influence matrix."""
    return "out" if price < NEGLIGIBLE else "in"
