"""An effect with its price, and the data that effects are priced by."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from beamtouch_common.digits import Rounded
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.physics.structure import influence_of
from beamtouch_models.design.pricing.noise import ReadingErrors
from beamtouch_models.design.scene import Scene
from beamtouch_models.errors import SceneError
from beamtouch_models.runtime.metadata_parts import FilterChoice

Verdict = Literal["in", "out", "floor", "not stated", "not modelled"]

NEGLIGIBLE = 0.1
"""Sum of the prices of the effects that are left out, in units of the noise, is less than this."""
VERDICTS: dict[Verdict, tuple[str, str]] = {
    "in": ("included", "the model computes it"),
    "out": ("left out", f"the prices of all that is left out sum to less than {NEGLIGIBLE:g}"),
    "floor": ("in intervals", "an error that no filter averages away; the intervals of each answer allow for it"),
    "not stated": ("not stated", "not known from the scene; the remark says what would tell it"),
    "not modelled": ("not modelled", "it matters, but no part of the model includes it"),
}
"""Words of each verdict for people, with their meaning."""


@dataclass(frozen=True, repr=False)
class Effect(Rounded):
    """An effect, priced for a scene."""

    name: str
    price: float | None
    """The largest change in deflection that it causes, over the noise of a sample; None if the scene does not state the
    data for it."""
    verdict: Verdict
    """"in" or "out" of the influence matrix; "floor": part of the covariance of every sample; "not modelled": it
    matters, but no part of the model can include it."""
    reason: str
    having: Scene | None = field(default=None, repr=False)
    lacking: Scene | None = field(default=None, repr=False)
    """The scene with and without the effect, if the two differ."""
    leave_out: Callable[[Scene], Scene] | None = field(default=None, repr=False)
    """Removes the effect from a scene; None if that changes nothing."""


@dataclass(frozen=True, eq=False)
class Pricing:
    """The data for pricing the effects of a scene."""

    scene: Scene
    influence: InfluenceFunction
    """Of the scene as stated."""
    filter: FilterChoice
    readings: ReadingErrors
    sensor_mm: Floats
    """(sensors, axes) places at which effects are priced."""

    @property
    def noise_mm(self) -> float:
        """Noise of a sample behind the filter."""
        return self.readings.behind(self.filter).sample_mm

    @property
    def load_mm(self) -> Floats:
        """(loads, axes) places of the contacts."""
        return self.influence.place_mm

    @cached_property
    def stated_mm(self) -> Floats:
        """Deflection (loads, sensors) of the scene as stated, at the largest force."""
        return self.influence.force_n[1] * self.influence.matrix(self.sensor_mm)

    @cached_property
    def price_of_all(self) -> float:
        """The largest deflection of the scene as stated, in units of the noise."""
        return self.in_noise(self.stated_mm)

    def price(self, having: Scene, lacking: Scene) -> float:
        """Return the largest difference in deflection between two scenes, in units of the noise."""
        deflection = [
            self.stated_mm if scene is self.scene else self._under_force_mm(scene) for scene in (having, lacking)
        ]
        return self.in_noise(deflection[0] - deflection[1])

    def in_noise(self, deflection_mm: Floats) -> float:
        """Return the largest deflection in units of the noise; raises SceneError beyond the range of float64."""
        with np.errstate(over="ignore"):
            price = float(np.abs(deflection_mm).max(initial=0.0) / self.noise_mm)
        if not math.isfinite(price):
            message = "sensors: the noise is too small next to the deflection to price effects in; state a larger one"
            raise SceneError(message)
        return price

    def _under_force_mm(self, scene: Scene) -> Floats:
        return scene.contact.force_range_n[1] * influence_of(scene).at(self.sensor_mm, self.load_mm)


def verdict_of(price: float) -> Verdict:
    """Return whether an effect with this price is in the influence matrix."""
    return "out" if price < NEGLIGIBLE else "in"


def effect_stated(pricing: Pricing, name: str, reason: str, leave_out: Callable[[Scene], Scene]) -> Effect:
    """Return an effect that the scene states, priced against the scene without it."""
    lacking = leave_out(pricing.scene)
    price = pricing.price(pricing.scene, lacking)
    return Effect(name, price, verdict_of(price), reason, pricing.scene, lacking, leave_out)
