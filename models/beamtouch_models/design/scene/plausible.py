"""Obvious mistakes in a scene: places off the beam, in contradiction or in metres, and numbers in other units."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

from beamtouch_common.digits import digits
from beamtouch_common.units import MM
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.measured import Measured, in_words
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.design.scene.tables import Contact, Sensors

MM_PER_M, UM_PER_MM = 1000, 1000
ROUNDING = 1e-9
"""Share of the beam's length by which sensors may be too close to something: 3 * 0.1 and 0.3 are the same position."""
SHORTEST_MM, NARROWEST_MM, THINNEST_MM = 1.0, 0.1, 0.01
"""Smallest length, width and thickness; a smaller beam is no place for a proximity sensor."""
WIDEST, DEEPEST = 4.0, 1.0
"""Largest width and thickness over the length; anything larger is not a beam, or its length is in another unit."""
NOISIEST = 0.1
"""Largest noise of a reading over the range of the sensor."""
STIFFEST_GPA = 1500.0
"""Diamond has 1200 GPa."""
PSI_PER_GPA = 145038
UNITS = {"MPa": 1e3, "psi": PSI_PER_GPA, "Pa": 1e9}
"""Other units of a modulus, the largest first: how many of them are a GPa."""
LIGHTEST_KG_M3, HEAVIEST_KG_M3 = 20.0, 25_000.0
"""Foams and osmium; a smaller number is a density in g/cm3."""
MIN_EXPANSION, MAX_EXPANSION = 1e-3, 1e3
"""Smallest and largest expansion in um/(m K); glass ceramics of telescopes have 0.01, rubbers 300. Less is in 1/K."""


def misplaced(beam: Beam, contact: Contact, sensors: Sensors) -> Iterator[str]:
    """Yield what to change in each place that is clearly a mistake."""
    length, on_the_beam = beam.length_mm, f"the beam, 0..{beam.length_mm:g} mm"
    if len(contact.ranges_mm) > 1:
        yield "contact has x_mm and y_mm, but a beam has one axis; state position_mm in their place"
        return
    yield from _in_metres(beam, contact, sensors)
    if contact.position_mm[0] < 0 or contact.position_mm[1] > length:
        yield f"contact.position_mm = {list(contact.position_mm)} reaches beyond {on_the_beam}"
    if contact.width_mm >= length:
        yield f"contact.width_mm = {contact.width_mm:g} must be less than beam.length_mm = {length:g}"
    if any(not 0 <= place <= length for place in sensors.fixed_mm):
        yield f"sensors.fixed_mm reaches beyond {on_the_beam}"
    for start, end in sensors.keep_out_mm:
        if end <= 0 or start >= length:
            yield f"sensors.keep_out_mm has [{start:g}, {end:g}], off {on_the_beam}; correct it, or remove it"
    yield from too_noisy(sensors)
    if sensors.size_mm >= length:
        yield f"sensors.size_mm = {sensors.size_mm:g} must be less than beam.length_mm = {length:g}"
    yield from too_close(length, beam.held_mm, sensors, sensors.fixed_mm, "sensors: fixed_mm has")


def too_noisy(sensors: Sensors) -> Iterator[str]:
    """Yield what to change in a noise that the range of a sensor contradicts."""
    if sensors.noise_mm is not None and sensors.noise_mm > NOISIEST * (sensors.range_mm[1] - sensors.range_mm[0]):
        yield (
            f"sensors.noise_mm = {sensors.noise_mm:g} is more than a tenth of range_mm; if it is in um, write "
            f"{sensors.noise_mm / UM_PER_MM:g}"
        )


def in_its_unit(unit: str, sensors: Sensors) -> Iterator[str]:
    """Yield what to change in the range of sensors that show a unit: gaps are positive, other values need a range."""
    if unit == MM:
        # A stand-off lies within the range.
        if sensors.range_mm[0] <= 0:
            yield f"sensors.range_mm: a gap must be greater than 0, not {sensors.range_mm[0]:g}"
    elif "range_mm" not in sensors.model_fields_set:
        yield (
            f"sensors.range_mm is missing: state the smallest and the largest value in {unit} that the sensors show, "
            "as their data sheet or the input of their module has them"
        )


def not_of_measured(measured: Measured, contact: Contact, sensors: Sensors) -> Iterator[str]:
    """Yield what to change in what a scene states beside a measured structure."""
    size_mm, names = measured.size_mm, measured.loads.names
    places = {name: place if isinstance(place, tuple) else (place,) for name, place in measured.places_mm.items()}
    if (end_mm := min(size_mm)) <= SHORTEST_MM:
        yield (
            f"measured: the structure ends at {end_mm:g} mm, too short to tell places on it; if the places of its "
            f"loads are in metres, write {MM_PER_M * end_mm:g}"
        )
    yield from _too_far(measured, contact)
    keys = ("position_mm",) if measured.axes == 1 else ("x_mm", "y_mm")
    for key, (low, high), length in zip(keys, contact.ranges_mm, size_mm, strict=True):
        if low < 0 or high > length:
            stated = "length_mm" if measured.axes == 1 else f"length_{key}"
            yield (
                f"contact.{key} = {[low, high]} reaches beyond the structure, 0..{length:g} mm; correct it, or state "
                f"measured.{stated}"
            )
    moved = "sensors stand where they were measured; leave it out"
    for key in ("mounting_tolerance_mm", "min_distance_mm", "keep_out_mm", "keep_out"):
        if getattr(sensors, key):
            yield f"sensors.{key} is for a beam or a plate; {moved}"
    if contact.width_mm:
        yield (
            "contact.width_mm is for a beam or a plate; a measured structure is as its loads pressed on it; leave it "
            "out"
        )
    for key, fixed in (
        ("fixed_mm", [(place,) for place in sensors.fixed_mm]),
        ("fixed", [(place.x_mm, place.y_mm) for place in sensors.fixed]),
    ):
        if away := [place for place in fixed if place not in places.values()]:
            yield (
                f"sensors.{key} has {in_words(away[0])} mm, where the table has no sensor; its sensors are "
                f"{_by_name(places)}"
            )
    if sensors.count != "auto" and sensors.count_range[0] > len(names):
        yield f"sensors.count = {sensors.count_range[0]}, but the table has {len(names)} sensors: {', '.join(names)}"


def _too_far(measured: Measured, contact: Contact) -> Iterator[str]:
    """Yield what to change where sensors show more than a structure of that length can bend."""
    loads, length_mm = measured.loads, math.hypot(*measured.size_mm)
    if loads.unit != MM:
        return
    shown = {name: abs(column).tolist() for name, column in zip(loads.names, loads.influence_mm_per_n.T, strict=True)}
    bent_mm = {name: contact.force_range_n[1] * max(filter(math.isfinite, column)) for name, column in shown.items()}
    name = max(bent_mm, key=lambda name: bent_mm[name])
    if bent_mm[name] > length_mm:
        most, force_n = digits(bent_mm[name], 3), contact.force_range_n[1]
        yield (
            f"measured.influence: {name} shows {most} mm under {force_n:g} N, more than the structure is long; if the "
            f"table is in um, divide its deflections by {UM_PER_MM}; if they are in another unit, name it, as "
            f"{name}_deflection_uV/V"
        )


def _by_name(places: Mapping[str, tuple[float, ...]]) -> str:
    return ", ".join(f"{name} at {in_words(place)} mm" for name, place in places.items())


def too_close(
    length_mm: float, held_mm: Sequence[float], sensors: Sensors, places_mm: Sequence[float], named: str
) -> Iterator[str]:
    """Yield what to change where a sensor is too close to something that `taken_mm` names, or to another sensor.

    `named` begins each sentence: it says whose places they are. `length_mm` and `held_mm` as for `taken_mm`.
    """
    for place in places_mm:
        for words, start, end in taken_mm(length_mm, held_mm, sensors):
            if start < place < end:
                yield (
                    f"{named} {place:g} mm, where a housing of size_mm = {sensors.size_mm:g} {words}; move that "
                    "sensor, or correct size_mm"
                )
    key = "size_mm" if sensors.size_mm >= sensors.min_distance_mm else "min_distance_mm"
    least_mm = max(sensors.size_mm, sensors.min_distance_mm)
    for left, right in pairwise(sorted(places_mm)):
        if right - left < least_mm - ROUNDING * length_mm:
            yield (
                f"{named} {left:g} and {right:g} mm, {digits(right - left, 3)} mm apart, less than {key} = "
                f"{least_mm:g}; move one, or correct {key}"
            )


def taken_mm(length_mm: float, held_mm: Sequence[float], sensors: Sensors) -> Iterator[tuple[str, float, float]]:
    """Yield where no sensor may stand: what a housing would do there, and the stretch of its centre, without its ends.

    The structure has this length, and its deflection is zero at `held_mm`. The stretches are shorter by what is
    rounding.
    """
    half, near = sensors.size_mm / 2, ROUNDING * length_mm
    yield "reaches beyond the end at 0 mm", -math.inf, half - near
    yield f"reaches beyond the end at {length_mm:g} mm", length_mm - half + near, math.inf
    for support_mm in held_mm:
        beside = max(half - near, near)  # nothing moves at a support: no point stands there either
        yield f"stands on the support at {support_mm:g} mm", support_mm - beside, support_mm + beside
    for start, end in sensors.keep_out_mm:
        yield f"reaches into [{start:g}, {end:g}] of keep_out_mm", start - half + near, end + half - near


def _in_metres(beam: Beam, contact: Contact, sensors: Sensors) -> Iterator[str]:
    """Yield what to write for each list whose places, all next to the left end, are on the beam if they are metres."""
    places_by_key: dict[str, list[float]] = {
        "beam.supports: at_mm": [] if isinstance(beam.supports, str) else [support.at_mm for support in beam.supports],
        "contact.position_mm": list(contact.position_mm),
        "sensors.fixed_mm": sensors.fixed_mm,
        **{f"sensors.keep_out_mm[{i}]": list(stretch) for i, stretch in enumerate(sensors.keep_out_mm)},
    }
    for key, places in places_by_key.items():
        if 0 < max(places, default=0) <= beam.length_mm / MM_PER_M:
            given, right = (", ".join(f"{times * place:g}" for place in places) for times in (1, MM_PER_M))
            yield f"{key} = [{given}] is next to the left end of the beam; if it is in metres, write [{right}]"


def in_other_units(beam: Beam) -> Iterator[str]:
    """Yield what to change in each such number."""
    yield from _sizes(beam)
    yield from _properties(beam)


def _sizes(beam: Beam) -> Iterator[str]:
    sections = [("beam", beam.width_mm, beam.thickness_mm)]
    sections += [
        (f"beam.segments[{i}]", segment.width_mm, segment.thickness_mm) for i, segment in enumerate(beam.segments)
    ]
    sizes: list[tuple[str, float | None, float, float]] = [("beam.length_mm", beam.length_mm, SHORTEST_MM, 1.0)]
    for name, width_mm, thickness_mm in sections:
        sizes.append((f"{name}.width_mm", width_mm, NARROWEST_MM, WIDEST))
        sizes.append((f"{name}.thickness_mm", thickness_mm, THINNEST_MM, DEEPEST))
    for key, value, least, most in sizes:
        if value is not None and value < least:
            yield f"{key} = {value:g} is too small for a beam; if it is in metres, write {1000 * value:g}"
        if value is not None and value > most * beam.length_mm:
            yield (
                f"{key} = {value:g} is too much for beam.length_mm = {beam.length_mm:g}; state all of them in mm, and "
                "the length along the beam"
            )


def _properties(beam: Beam) -> Iterator[str]:
    if beam.shear_modulus_gpa is not None:
        yield from _too_stiff("beam.shear_modulus_gpa", beam.shear_modulus_gpa)
    yield from implausible_material("beam", beam)
    young, shear = beam.modulus_gpa, beam.shear_modulus_gpa
    if young is not None and shear is not None and shear >= young:
        yield f"beam.shear_modulus_gpa = {shear:g} must be less than Young's modulus, {young:g}; metals have 0.38 of it"


def _too_stiff(key: str, modulus: float) -> Iterator[str]:
    if modulus > STIFFEST_GPA:
        right_gpa = {unit: modulus / times for unit, times in UNITS.items() if modulus / times <= STIFFEST_GPA}
        advices = (f"if it is in {unit}, write {digits(gpa, 4)}" for unit, gpa in right_gpa.items())
        yield f"{key} = {modulus:g} is more than any material has; {next(advices, 'state it in GPa')}"


def implausible_material(table: str, solid: Beam | Plate) -> Iterator[str]:
    """Yield what to change in a modulus, density or expansion that no material has."""
    if solid.youngs_modulus_gpa is not None:
        yield from _too_stiff(f"{table}.youngs_modulus_gpa", solid.youngs_modulus_gpa)
    density, expansion = solid.density_kg_m3, solid.expansion_um_per_m_k
    if density is not None and density < LIGHTEST_KG_M3:
        right = 1000 * density
        yield f"{table}.density_kg_m3 = {density:g} is less than any material has; if it is in g/cm3, write {right:g}"
    if expansion is not None and expansion < MIN_EXPANSION:
        key, right = f"{table}.expansion_um_per_m_k", 1e6 * expansion
        yield f"{key} = {expansion:g} is less than any material has; if it is in 1/K, write {right:g}"
    for key, value, most, unit in (
        ("density_kg_m3", density, HEAVIEST_KG_M3, "kg/m3"),
        ("expansion_um_per_m_k", expansion, MAX_EXPANSION, "um/(m K)"),
    ):
        if value is not None and value > most:
            yield f"{table}.{key} = {value:g} is more than any material has; state it in {unit}"
