"""Prices of the effects of plates."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.motion import GRAVITY, point_masses, sag_mm
from beamtouch_models.design.physics.plate import influence, load_places_mm, supported_plate
from beamtouch_models.design.pricing.effect import NEGLIGIBLE, Effect, Pricing
from beamtouch_models.design.pricing.of_solids import contact_width, dynamics
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import SHEAR_COEFFICIENT
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.errors import SceneError
from beamtouch_models.numbers import at_least, at_most

MOST_BENT, MUCH_BENT = 0.5, 0.2
"""Deflections over the thickness beyond which a plate is refused, and from which on a price says so."""
STIFFER = 1.1
"""Stiffness of a spring, over that stated, of which a price says what it costs."""
DIFFERENCE = 1e-3
"""Step of a derivative along an axis, over the length."""
STRETCH = 0.262
"""By how much of (deflection / thickness)^2 stretching makes the deflection of a round plate smaller that is simply
supported and free to slide; Timoshenko & Woinowsky-Krieger, Theory of Plates and Shells, 1959, table 82."""


class Bends(NamedTuple):
    """Deflections of a plate over its thickness. That it sinks or tilts on its springs is no part of them."""

    under_force: Floats
    """(loads, places) under the largest force."""
    under_weight: Floats
    """(places,) under the own weight; 0 if its mass is not stated."""

    @property
    def most(self) -> float:
        """The largest under both."""
        return float(np.abs(self.under_force + self.under_weight).max())


def bends_over_thickness(scene: Scene, plate: Plate) -> Bends:
    """Return the deflections of a plate over its thickness, at its rim and where contacts may be."""
    solved, loads = supported_plate(plate), load_places_mm(scene, plate)
    size = np.array(plate.size_mm)
    rim = (
        np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [0.0, 0.5], [1.0, 0.5], [0.0, 1.0], [0.5, 1.0], [1.0, 1.0]])
        * size
    )
    at_mm = np.concatenate([loads, rim])
    bent_mm = scene.contact.force_range_n[1] * solved.bends(at_mm, loads, scene.contact.width_mm)
    sunk_mm = np.zeros(len(at_mm))
    if (points := point_masses(plate)) is not None:
        places, masses = points
        sunk_mm = GRAVITY * masses @ solved.bends(at_mm, places)
    return Bends(bent_mm / plate.thickness_mm, sunk_mm / plate.thickness_mm)


def check_linear(scene: Scene, plate: Plate) -> None:
    """Raise SceneError if a plate bends by more than half its thickness, where linear theory ends."""
    bends = bends_over_thickness(scene, plate)
    if bends.most <= MOST_BENT:
        return
    force_n = scene.contact.force_range_n[1]
    of_force, of_weight = (float(np.abs(one).max()) for one in bends)
    less = ""
    if of_weight < MOST_BENT:
        less = f", or end contact.force_n at {at_most(force_n * (MOST_BENT - of_weight) / of_force):g} N"
    raise SceneError(
        f"at {force_n:g} N the plate bends by {digits(bends.most, 2)} times its thickness, with its own weight; beyond "
        f"{MOST_BENT:g} it stretches, and linear theory does not hold: write plate.thickness_mm = "
        f"{at_least(plate.thickness_mm * _thicker(of_force, of_weight)):g} or more{less}"
    )


def _thicker(of_force: float, of_weight: float) -> float:
    """Return how many times as thick a plate must be that bends by more than MOST_BENT.

    Over the thickness, its bend under a force falls with the fourth power of the thickness, under its weight with the
    third.
    """
    most = max(2.0, 2 * max(of_force, of_weight) / MOST_BENT)
    return float(brentq(lambda times: (of_force / times + of_weight) / times**3 - MOST_BENT, 1.0, most))


def _shear(pricing: Pricing) -> Effect:
    """Price shear by the sum of moments, -D (w_xx + w_yy), over kappa G t.

    That is exact on polygons with simply supported edges, under loads away from the sensor; Wang, Relationship between
    Mindlin and Kirchhoff bending solutions, J. Eng. Mech. 120 (1994).
    """
    scene, plate = pricing.scene, _plate_of(pricing)
    solved, size = supported_plate(plate), np.array(plate.size_mm)
    modulus_n_mm2 = plate.modulus_gpa * 1e3 / (2 * (1 + plate.poisson))
    moments = plate.rigidity_n_mm * solved.curvatures(pricing.sensor_mm, pricing.load_mm, scene.contact.width_mm)
    # Closer to its load than the thickness, no plate theory holds.
    apart = np.linalg.norm((pricing.load_mm[:, None] - pricing.sensor_mm) / size, axis=2) * float(size.max())
    moments = np.where(apart >= plate.thickness_mm, moments, 0.0)
    shear_mm = scene.contact.force_range_n[1] * moments / (SHEAR_COEFFICIENT * modulus_n_mm2 * plate.thickness_mm)
    price = pricing.in_noise(shear_mm)
    if price < NEGLIGIBLE:
        return Effect("shear", price, "out", "the plate is thin (Mindlin's theory, estimated)")
    reason = "the plate yields to shear beside its loads (Mindlin's theory, estimated)"
    return Effect("shear", price, "not modelled", reason)


def _large_deflection(pricing: Pricing) -> Effect:
    bent = bends_over_thickness(pricing.scene, _plate_of(pricing)).most
    share = STRETCH * bent**2
    price = pricing.in_noise(np.array([share * bent * _plate_of(pricing).thickness_mm]))
    told = f"the plate bends by {digits(100 * bent, 2)} % of its thickness"
    if price < NEGLIGIBLE:
        return Effect("large deflection", price, "out", told)
    near = ", more than a fifth: near its end of linear theory, a half" if bent > MUCH_BENT else ""
    reason = f"{told}{near}; stretching makes this some {digits(100 * share, 1)} % less (estimated)"
    return Effect("large deflection", price, "not modelled", reason)


def _self_weight(pricing: Pricing) -> Effect:
    # Deflections are linear in the load: after a tare, a contact adds the same deflection with or without the weight.
    sag = sag_mm(_plate_of(pricing))
    told = "" if sag is None else f"; set the gaps with the plate in place, as it sinks by {digits(sag, 3)} mm"
    return Effect("self-weight", 0.0, "out", f"constant, so a tare removes it{told}")


def _heat(pricing: Pricing) -> Effect:
    """Say how far a difference of temperature between the faces bows a plate: alpha dT l^2 / (8 t) along its diagonal.

    Timoshenko & Woinowsky-Krieger, 1959, art. 14.
    """
    plate = _plate_of(pricing)
    name, expansion = "heat from one side", plate.expansion_per_k
    if expansion is None:
        return Effect(name, None, "not stated", "state plate.material or expansion_um_per_m_k")
    bow_um = 1e3 * expansion * math.hypot(*plate.size_mm) ** 2 / (8 * plate.thickness_mm)
    reason = (
        f"1 K between its faces bows it by {digits(bow_um, 2)} um; a rest removes that. Supports are taken to let it "
        "slide as it warms"
    )
    return Effect(name, None, "not stated", reason)


def springs_off(scene: Scene, plate: Plate) -> Floats:
    """Return what a spring that is STIFFER than said does to answers, (springs, loads, 3): dx, dy in mm, and dF / F.

    By Castigliano, the flexibility c of a support moves what a sensor shows of a load by R(load) R(sensor) dc, with the
    reactions R of that support to 1 at either. The answer is that which fits the readings best, with sensors on the
    supports; those are points on springs.
    """
    load_mm = load_places_mm(scene, plate)
    points = np.array([[one.x_mm, one.y_mm] for one in plate.support_list], dtype=np.float64)
    flexibility = np.array([1 / (one.stiffness_n_per_mm or math.inf) for one in plate.support_list])
    shown = influence(plate, points, load_mm)
    sides = np.stack([shown, shown, shown], axis=2)
    for axis, length_mm in enumerate(plate.size_mm):
        step = np.zeros(2)
        step[axis] = DIFFERENCE * length_mm
        low, high = (np.clip(load_mm + side * step, 0.0, plate.size_mm) for side in (-1, 1))
        apart = (high - low)[:, axis]
        sides[..., axis] = (influence(plate, points, high) - influence(plate, points, low)) / apart[:, None]
    of_loads, of_sensors = shown / flexibility, influence(plate, points, points) / flexibility
    less = flexibility * (1 / STIFFER - 1)
    moved = less[:, None, None] * of_loads.T[:, :, None] * of_sensors.T[:, None, :]
    off: Floats = np.einsum("lps,nls->nlp", np.linalg.pinv(sides), moved)
    return off


def _springs(pricing: Pricing) -> Effect:
    """Say what springs do that are stiffer than stated: all alike, or one of them."""
    name, scene, plate = "spring stiffness", pricing.scene, _plate_of(pricing)
    if any(support.is_line for support in plate.support_list) or not plate.is_sprung:
        return Effect(name, 0.0, "out", "not every support is a spring at a point")
    off = springs_off(scene, plate)
    together = np.abs(off.sum(axis=0)).mean(axis=0)
    alone = np.linalg.norm(off[..., :2], axis=2)
    more = digits(100 * (STIFFER - 1), 2)
    reason = (
        f"if all are {more} % stiffer than stated, forces are {digits(100 * together[2], 2)} % too small and places "
        f"{digits(float(np.hypot(together[0], together[1])), 2)} mm off; if one is, places are "
        f"{digits(float(alone.mean(axis=1).max()), 2)} mm off on average, and {digits(float(alone.max()), 2)} mm at "
        "most, with sensors on the springs: measure each spring"
    )
    return Effect(name, None, "not stated", reason)


def _plate_of(pricing: Pricing) -> Plate:
    plate = pricing.scene.plate
    if plate is None:
        raise SceneError("plate is missing; add it")
    return plate


OF_PLATES: tuple[Callable[[Pricing], Effect], ...] = (
    _shear,
    _large_deflection,
    contact_width,
    _self_weight,
    dynamics,
    _springs,
    _heat,
)
