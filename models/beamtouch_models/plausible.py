"""Numbers of a beam that are only plausible in another unit than that of their key."""

from collections.abc import Iterator

from beamtouch_models.structure import Beam

SHORTEST_MM, NARROWEST_MM, THINNEST_MM = 1.0, 0.1, 0.01
"""Smallest length, width and thickness; a smaller beam is no place for a proximity sensor."""
STIFFEST_GPA = 1500.0
"""Diamond has 1200 GPa."""
LIGHTEST_KG_M3 = 20.0
"""Foams have this; a smaller number is a density in g/cm3."""


def in_other_units(beam: Beam) -> str:
    """Return what to change in the first such number; empty if there is none."""
    return next(_found(beam), "")


def _found(beam: Beam) -> Iterator[str]:
    sizes: list[tuple[str, float | None, float]] = [("beam.length_mm", beam.length_mm, SHORTEST_MM)]
    sections = [("beam", beam.width_mm, beam.thickness_mm)]
    sections += [(f"beam.segments[{i}]", one.width_mm, one.thickness_mm) for i, one in enumerate(beam.segments)]
    for name, width_mm, thickness_mm in sections:
        sizes += [(f"{name}.width_mm", width_mm, NARROWEST_MM), (f"{name}.thickness_mm", thickness_mm, THINNEST_MM)]
    for key, value, least in sizes:
        if value is not None and value < least:
            yield f"{key} = {value:g} is too small for a beam; if it is in metres, write {1000 * value:g}"
    modulus, density = beam.youngs_modulus_gpa, beam.density_kg_m3
    if modulus is not None and modulus > STIFFEST_GPA:
        right = modulus / 1000
        yield f"beam.youngs_modulus_gpa = {modulus:g} is more than any material has; if it is in MPa, write {right:g}"
    if density is not None and density < LIGHTEST_KG_M3:
        right = 1000 * density
        yield f"beam.density_kg_m3 = {density:g} is less than any material has; if it is in g/cm3, write {right:g}"
