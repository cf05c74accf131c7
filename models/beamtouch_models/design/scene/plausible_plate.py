"""Obvious mistakes in the scene of a plate, and the places on it where no sensor may stand."""

import math
from collections.abc import Iterator, Sequence
from itertools import combinations

from beamtouch_common.digits import digits
from beamtouch_models.design.scene.plate import Plate, PlateSupport, in_words
from beamtouch_models.design.scene.plausible import (
    MM_PER_M,
    NARROWEST_MM,
    ROUNDING,
    THINNEST_MM,
    implausible_material,
    too_noisy,
)
from beamtouch_models.design.scene.tables import Contact, Place, Rectangle, Sensors

THICKEST = 0.25
"""Largest thickness over the shorter side; anything larger is not a plate, or is in another unit."""
SOFTEST_N_PER_MM, STIFFEST_N_PER_MM = 1e-3, 1e9
"""Springs that are softer carry no plate; stiffer ones are rigid."""
AXES = "x_mm", "y_mm"
PlateXY = tuple[float, float]


def implausible_plate(plate: Plate, contact: Contact, sensors: Sensors) -> Iterator[str]:
    """Yield what to change in each number of a plate that is clearly a mistake, its unit first."""
    yield from _sizes(plate)
    yield from implausible_material("plate", plate)
    yield from _springs(plate)
    x, y = plate.size_mm
    on_the_plate = f"the plate, 0..{x:g} by 0..{y:g} mm"
    for key, (low, high), length in zip(AXES, contact.ranges_mm, plate.size_mm, strict=True):
        if low < 0 or high > length:
            yield f"contact.{key} = {[low, high]} reaches beyond {on_the_plate}"
        if 0 < high <= length / MM_PER_M:
            yield (
                f"contact.{key} = {[low, high]} is next to the edge of the plate; if it is in metres, write "
                f"{[MM_PER_M * low, MM_PER_M * high]}"
            )
    if contact.width_mm >= min(plate.size_mm):
        yield f"contact.width_mm = {contact.width_mm:g} must be less than the plate's shorter side, {min(x, y):g} mm"
    if sensors.size_mm >= min(plate.size_mm):
        yield f"sensors.size_mm = {sensors.size_mm:g} must be less than the plate's shorter side, {min(x, y):g} mm"
    for part in sensors.keep_out:
        if any(high <= 0 or low >= length for (low, high), length in zip(_sides(part), plate.size_mm, strict=True)):
            yield f"sensors.keep_out has {_words_of(part)}, off {on_the_plate}; correct it, or remove it"
    yield from too_noisy(sensors)
    yield from too_close_on_plate(plate, sensors, [xy_of(place) for place in sensors.fixed], "sensors: fixed has")


def _sizes(plate: Plate) -> Iterator[str]:
    for key, value, least in (
        ("length_x_mm", plate.length_x_mm, NARROWEST_MM * 10),
        ("length_y_mm", plate.length_y_mm, NARROWEST_MM * 10),
        ("thickness_mm", plate.thickness_mm, THINNEST_MM),
    ):
        if value < least:
            yield f"plate.{key} = {value:g} is too small for a plate; if it is in metres, write {MM_PER_M * value:g}"
    if plate.thickness_mm > THICKEST * min(plate.size_mm):
        yield (
            f"plate.thickness_mm = {plate.thickness_mm:g} is too thick for a plate whose shorter side is "
            f"{min(plate.size_mm):g} mm; state all of them in mm"
        )


def _springs(plate: Plate) -> Iterator[str]:
    for support in plate.support_list:
        stiffness = support.stiffness_n_per_mm
        if stiffness is not None and not SOFTEST_N_PER_MM <= stiffness <= STIFFEST_N_PER_MM:
            yield (
                f"plate: a support has {stiffness:g} N/mm; give {SOFTEST_N_PER_MM:g} to {STIFFEST_N_PER_MM:g}, or "
                "leave it out where it is rigid"
            )


def xy_of(place: Place) -> PlateXY:
    """Return the coordinates of a place."""
    return place.x_mm, place.y_mm


def _sides(part: Rectangle) -> tuple[tuple[float, float], tuple[float, float]]:
    return part.x_mm, part.y_mm


def _words_of(part: Rectangle) -> str:
    return ", ".join(f"{key} = [{low:g}, {high:g}]" for key, (low, high) in zip(AXES, _sides(part), strict=True))


def taken_on_plate(plate: Plate, sensors: Sensors, place: PlateXY) -> str:
    """Return what a housing with its centre at a place would do there that it must not; empty if it may stand there."""
    half, near = sensors.size_mm / 2, ROUNDING * max(plate.size_mm)
    for key, value, length in zip(AXES, place, plate.size_mm, strict=True):
        if not half - near <= value <= length - half + near:
            return f"reaches beyond the edge at {key} = {0.0 if value < length / 2 else length:g}"
    for support in plate.support_list:
        # Nothing moves at a rigid support: no point stands there either.
        beside = max(half - near, 0.0 if support.stiffness_n_per_mm else near)
        if _to_support(support, place) < beside:
            return f"stands on the support at {in_words((support.x_mm, support.y_mm))}"
    for part in sensors.keep_out:
        apart = math.hypot(
            *(max(low - value, 0.0, value - high) for (low, high), value in zip(_sides(part), place, strict=True))
        )
        is_inside = all(low < value < high for (low, high), value in zip(_sides(part), place, strict=True))
        if is_inside or apart < half - near:
            return f"reaches into {_words_of(part)} of keep_out"
    return ""


def _to_support(support: PlateSupport, place: PlateXY) -> float:
    """Return the distance of a place from a support, or from its line."""
    at = support.x_mm, support.y_mm
    return math.hypot(*(value - fixed for value, fixed in zip(place, at, strict=True) if fixed is not None))


def too_close_on_plate(plate: Plate, sensors: Sensors, places: Sequence[PlateXY], named: str) -> Iterator[str]:
    """Yield what to change where a sensor is off the plate, or too close to its edge, a support, or another sensor.

    `named` begins each sentence: it says whose places they are.
    """
    for x, y in places:
        if words := taken_on_plate(plate, sensors, (x, y)):
            yield (
                f"{named} {x:g}, {y:g} mm, where a housing of size_mm = {sensors.size_mm:g} {words}; move that sensor, "
                "or correct size_mm"
            )
    key = "size_mm" if sensors.size_mm >= sensors.min_distance_mm else "min_distance_mm"
    least_mm = max(sensors.size_mm, sensors.min_distance_mm)
    for one, other in combinations(places, 2):
        if (apart := math.dist(one, other)) < least_mm - ROUNDING * max(plate.size_mm):
            yield (
                f"{named} {one[0]:g}, {one[1]:g} and {other[0]:g}, {other[1]:g} mm, {digits(apart, 3)} mm apart, less "
                f"than {key} = {least_mm:g}; move one, or correct {key}"
            )
