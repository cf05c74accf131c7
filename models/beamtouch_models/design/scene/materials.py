"""Materials of beams, with what a scene and a report need to know of each at room temperature, and the source.

The ranges are those of real pieces. They say which stated modulus is implausible, and how far a modulus from the table
may be off: the force scales with it, the position does not.
"""

from dataclasses import dataclass
from typing import Literal

GERE = "Gere & Goodno, Mechanics of Materials, app. I (tables I-1, I-2, I-4)"


@dataclass(frozen=True)
class Material:
    """A material."""

    youngs_modulus_gpa: float
    modulus_range_gpa: tuple[float, float]
    """Smallest and largest modulus of real pieces."""
    density_kg_m3: float
    expansion_um_per_m_k: float
    """Coefficient of linear thermal expansion."""
    source: str
    poisson_ratio: float = 0.3
    """Lateral contraction over elongation, which stiffens plates: steel, EN 1993-1-1, 3.2.6; aluminium, EN 1999-1-1,
    3.2.5; glass, EN 572-1; brass, table I-2 of Gere & Goodno; plastics, data sheets; glass fibre, NEMA LI 1."""
    strength_mpa: float | None = None
    """Stress at which a usual, weak grade yields or breaks; None where grades differ too much for one number."""
    grade: str = ""
    """That grade, and the source."""


MaterialName = Literal[
    "steel", "stainless", "spring-steel", "aluminium", "brass", "glass", "acrylic", "polycarbonate", "glass-fibre"
]

MATERIALS: dict[MaterialName, Material] = {
    "steel": Material(
        210.0, (190.0, 215.0), 7850.0, 12.0, f"EN 1993-1-1:2005, 3.2.6; EN 1993-1-2:2005, 3.2.2; range: {GERE}",
        strength_mpa=235.0, grade="S235 up to 16 mm yields: EN 10025-2, table 7",
    ),
    "stainless": Material(
        200.0, (185.0, 220.0), 7900.0, 16.0,
        "EN 10088-1:2005, annex E, for 1.4301 (AISI 304); 195 to 220 GPa and 10 to 16.5 um/(m K) over all grades, less "
        "in the rolling direction",
    ),
    "spring-steel": Material(
        206.0, (185.0, 215.0), 7850.0, 12.0, "EN 10270-1:2011 and EN 13906-1:2013; expansion as steel"
    ),
    "aluminium": Material(70.0, (68.0, 79.0), 2700.0, 23.0, f"EN 1999-1-1:2007, 3.2.5; range: {GERE}"),
    "brass": Material(103.0, (96.0, 110.0), 8500.0, 20.0, f"{GERE}, middles of the ranges", poisson_ratio=0.34),
    "glass": Material(70.0, (48.0, 83.0), 2500.0, 9.0, f"EN 572-1:2012, soda-lime; range over all glasses: {GERE}",
        poisson_ratio=0.2, strength_mpa=45.0, grade="float glass breaks: EN 572-1",),
    "acrylic": Material(
        3.3, (2.2, 3.8), 1190.0, 70.0,
        "PMMA; data sheets of Plexiglas GS and XT (ISO 527-2, ISO 1183); the modulus falls as it warms and creeps",
        poisson_ratio=0.37,
    ),
    "polycarbonate": Material(
        2.4, (2.0, 2.5), 1200.0, 65.0,
        "data sheets of Makrolon (ISO 527, ISO 1183, ISO 11359), 65 to 70 um/(m K); it creeps: 1.9 GPa after 1000 h",
        poisson_ratio=0.38, strength_mpa=60.0, grade="it yields: data sheets of Makrolon, ISO 527",
    ),
    "glass-fibre": Material(
        20.0, (15.0, 28.0), 1850.0, 14.0,
        "woven glass in epoxy, G-10 and FR-4: NEMA LI 1 (18.6 GPa lengthwise, 15.2 crosswise, 9 um/(m K)); "
        "IEC 60893-3-2, EP GC 202 (24 GPa); it scatters with weave, direction and glass content",
        poisson_ratio=0.14,
    ),
}  # fmt: skip
"""Values at room temperature."""


def density_kg_m3_of(stated_kg_m3: float | None, material: MaterialName | None) -> float | None:
    """Return the density as stated, or else of the material; None without either."""
    if stated_kg_m3 is not None or material is None:
        return stated_kg_m3
    return MATERIALS[material].density_kg_m3


def expansion_per_k_of(stated_um_per_m_k: float | None, material: MaterialName | None) -> float | None:
    """Return the coefficient of thermal expansion in 1/K, as stated, or else of the material; None without either."""
    if stated_um_per_m_k is not None:
        return 1e-6 * stated_um_per_m_k
    return None if material is None else 1e-6 * MATERIALS[material].expansion_um_per_m_k
