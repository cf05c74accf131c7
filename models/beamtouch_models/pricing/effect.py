"""An effect with its price, the data that effects are priced with, and scenes without an effect."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.physics.beam import influence_matrix, load_positions_mm
from beamtouch_models.pricing.noise import ReadingErrors
from beamtouch_models.scene import Scene, change_scene

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


@dataclass(frozen=True, eq=False)
class Pricing:
    """The data for pricing the effects of a scene."""

    scene: Scene
    filter: FilterChoice
    readings: ReadingErrors
    sensor_mm: Floats
    """(sensors,) positions at which effects are priced."""

    @property
    def noise_mm(self) -> float:
        """Noise of a sample behind the filter."""
        return self.readings.behind(self.filter).sample_mm

    @cached_property
    def load_mm(self) -> Floats:
        """(loads,) positions of the contacts."""
        return load_positions_mm(self.scene)

    @cached_property
    def stated_mm(self) -> Floats:
        """Deflection (loads, sensors) of the scene as stated, at the largest force."""
        return self._under_force_mm(self.scene)

    @cached_property
    def price_of_all(self) -> float:
        """The largest deflection of the scene as stated, in units of the noise."""
        return self.in_noise(self.stated_mm)

    def price(self, having: Scene, lacking: Scene) -> float:
        """Return the largest difference in deflection between two scenes, in units of the noise."""
        return self.in_noise(self._deflection_mm(having) - self._deflection_mm(lacking))

    def in_noise(self, deflection_mm: Floats) -> float:
        """Return the largest deflection in units of the noise; raises SceneError beyond the range of float64."""
        with np.errstate(over="ignore"):
            price = float(np.abs(deflection_mm).max(initial=0.0) / self.noise_mm)
        if not math.isfinite(price):
            message = "sensors: the noise is too small next to the deflection to price effects in; state a larger one"
            raise SceneError(message)
        return price

    def _deflection_mm(self, scene: Scene) -> Floats:
        return self.stated_mm if scene is self.scene else self._under_force_mm(scene)

    def _under_force_mm(self, scene: Scene) -> Floats:
        return scene.contact.force_range_n[1] * influence_matrix(scene, self.sensor_mm, self.load_mm)


def verdict_of(price: float) -> Verdict:
    """Return whether an effect with this price is in the influence matrix."""
    return "out" if price < NEGLIGIBLE else "in"


without_shear = partial(change_scene, beam={"shear_modulus_gpa": None})
without_width = partial(change_scene, contact={"width_mm": 0.0})
"""The scene with point contacts."""
without_foundation = partial(change_scene, beam={"foundation_n_mm2": None})
"""Raises InputError if nothing else supports the beam."""
without_tolerance = partial(change_scene, sensors={"mounting_tolerance_mm": 0.0})
"""The scene with sensors at exactly known positions."""
without_adc = partial(change_scene, sensors={"adc_bits": None})
"""The scene without the steps of its ADC."""


def without_steps(scene: Scene) -> Scene:
    """Return the scene with a prismatic beam that has the mean compliance of the beam."""
    sections = scene.beam.sections
    starts = [0.0, *(section.to_mm for section in sections[:-1])]
    shares = [(section.to_mm - start) / scene.beam.length_mm for section, start in zip(sections, starts, strict=True)]
    compliance = sum(share / section.rigidity_n_mm2 for share, section in zip(shares, sections, strict=True))
    dropped = dict.fromkeys(("youngs_modulus_gpa", "shear_modulus_gpa", "width_mm", "thickness_mm"))
    return change_scene(scene, beam={**dropped, "segments": (), "flexural_rigidity_n_mm2": 1 / compliance})
