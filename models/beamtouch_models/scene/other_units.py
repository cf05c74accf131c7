"""Numbers of a beam that are only plausible in another unit than that of their key."""

from collections.abc import Iterator
from itertools import chain

from beamtouch_common.digits import digits
from beamtouch_models.scene.beam import Beam

SHORTEST_MM, NARROWEST_MM, THINNEST_MM = 1.0, 0.1, 0.01
"""Smallest length, width and thickness; a smaller beam is no place for a proximity sensor."""
WIDEST, DEEPEST = 4.0, 1.0
"""Largest width and thickness over the length; a beam beyond them is none, or its length is in another unit."""
STIFFEST_GPA = 1500.0
"""Diamond has 1200 GPa."""
PSI_PER_GPA = 145038
UNITS = (("MPa", 1e3, 1.0), ("psi", PSI_PER_GPA, 5.0), ("Pa", 1e9, 0.1))
"""Other units of a modulus: how many of them are a GPa, and the smallest modulus in GPa for which one is meant."""
LIGHTEST_KG_M3, HEAVIEST_KG_M3 = 20.0, 25_000.0
"""Foams and osmium; a smaller number is a density in g/cm3."""
MIN_EXPANSION, MAX_EXPANSION = 1e-3, 1e3
"""Smallest and largest expansion in um/(m K); glass ceramics of telescopes have 0.01, rubbers 300. Less is in 1/K."""


def in_other_units(beam: Beam) -> str:
    """Return what to change in the first such number; empty if there is none."""
    return next(chain(_sizes(beam), _properties(beam)), "")


def _sizes(beam: Beam) -> Iterator[str]:
    sections = [("beam", beam.width_mm, beam.thickness_mm)]
    sections += [(f"beam.segments[{i}]", one.width_mm, one.thickness_mm) for i, one in enumerate(beam.segments)]
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
    moduli = ("youngs_modulus_gpa", beam.youngs_modulus_gpa), ("shear_modulus_gpa", beam.shear_modulus_gpa)
    for key, modulus in moduli:
        if modulus is not None and modulus > STIFFEST_GPA:
            fits = [(unit, modulus / times) for unit, times, least in UNITS if least <= modulus / times <= STIFFEST_GPA]
            advice = f"if it is in {fits[0][0]}, write {digits(fits[0][1], 4)}" if fits else "state it in GPa"
            yield f"beam.{key} = {modulus:g} is more than any material has; {advice}"
    density, expansion = beam.density_kg_m3, beam.expansion_um_per_m_k
    if density is not None and density < LIGHTEST_KG_M3:
        right = 1000 * density
        yield f"beam.density_kg_m3 = {density:g} is less than any material has; if it is in g/cm3, write {right:g}"
    if expansion is not None and expansion < MIN_EXPANSION:
        key, right = "beam.expansion_um_per_m_k", 1e6 * expansion
        yield f"{key} = {expansion:g} is less than any material has; if it is in 1/K, write {right:g}"
    for key, value, most, unit in (
        ("density_kg_m3", density, HEAVIEST_KG_M3, "kg/m3"),
        ("expansion_um_per_m_k", expansion, MAX_EXPANSION, "um/(m K)"),
    ):
        if value is not None and value > most:
            yield f"beam.{key} = {value:g} is more than any material has; state it in {unit}"
    young, shear = beam.modulus_gpa, beam.shear_modulus_gpa
    if young is not None and shear is not None and shear >= young:
        yield f"beam.shear_modulus_gpa = {shear:g} must be less than Young's modulus, {young:g}; metals have 0.38 of it"
