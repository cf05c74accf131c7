"""Materials: their values, what goes before them, and the remarks on a modulus that no piece of them has."""

from pathlib import Path

import pytest

from beamtouch_models import frequency_hz
from beamtouch_models.design.scene import Scene, parse_scene
from beamtouch_models.design.scene.beam import changed_beam
from beamtouch_models.design.scene.materials import MATERIALS, MaterialName
from support.programs.in_process import Command
from support.surfaces.example_scenes import PAPER, SCENES

MODULUS = "youngs_modulus_gpa = 210"


def scene(instead: str) -> Scene:
    return parse_scene(PAPER.replace(MODULUS, instead), "scene.toml")


@pytest.mark.parametrize("name", MATERIALS)
def test_every_material_is_plausible_and_names_its_source(name: MaterialName) -> None:
    material = MATERIALS[name]
    low, high = material.modulus_range_gpa
    assert low <= material.youngs_modulus_gpa <= high
    # The speed of sound along a bar of any of these lies between 1400 m/s (acrylic) and 5400 m/s (glass).
    speed_m_s = (material.youngs_modulus_gpa * 1e9 / material.density_kg_m3) ** 0.5
    assert 1300 < speed_m_s < 5500
    assert 5 < material.expansion_um_per_m_k < 100
    assert len(material.source) > 20


@pytest.mark.parametrize(
    ("name", "modulus_gpa", "range_gpa", "density_kg_m3", "expansion_um_per_m_k", "poisson_ratio", "strength_mpa"),
    [
        # EN 1993-1-1 and 1993-1-2, EN 10088-1 (1.4301), EN 10270-1, EN 1999-1-1, EN 572-1; ranges and brass: Gere &
        # Goodno, app. I; plastics: their data sheets; glass fibre: NEMA LI 1 and IEC 60893-3-2.
        ("steel", 210, (190, 215), 7850, 12, 0.3, 235),
        ("stainless", 200, (185, 220), 7900, 16, 0.3, None),
        ("spring-steel", 206, (185, 215), 7850, 12, 0.3, None),
        ("aluminium", 70, (68, 79), 2700, 23, 0.3, None),
        ("brass", 103, (96, 110), 8500, 20, 0.34, None),
        ("glass", 70, (48, 83), 2500, 9, 0.2, 45),
        ("acrylic", 3.3, (2.2, 3.8), 1190, 70, 0.37, None),
        ("polycarbonate", 2.4, (2.0, 2.5), 1200, 65, 0.38, 60),
        ("glass-fibre", 20, (15, 28), 1850, 14, 0.14, None),
    ],
)
def test_a_material_has_the_values_of_its_standard(
    name: MaterialName,
    modulus_gpa: float,
    range_gpa: tuple[float, float],
    density_kg_m3: float,
    expansion_um_per_m_k: float,
    poisson_ratio: float,
    strength_mpa: float | None,
) -> None:
    material = MATERIALS[name]
    assert (material.youngs_modulus_gpa, material.modulus_range_gpa) == (modulus_gpa, range_gpa)
    assert (material.density_kg_m3, material.expansion_um_per_m_k) == (density_kg_m3, expansion_um_per_m_k)
    assert (material.poisson_ratio, material.strength_mpa) == (poisson_ratio, strength_mpa)


def test_a_material_is_worth_its_modulus_and_density_to_the_bit() -> None:
    text = (SCENES / "bench.toml").read_text()
    stated = parse_scene(text, "stated")
    as_steel = text.replace("youngs_modulus_gpa = 210", 'material = "steel"').replace("density_kg_m3 = 7850\n", "")
    steel = parse_scene(as_steel, "named")
    named = steel.beam
    assert named.youngs_modulus_gpa is named.density_kg_m3 is None
    assert (named.rigidity_n_mm2, frequency_hz(steel)) == (stated.beam.rigidity_n_mm2, frequency_hz(stated))
    assert named.expansion_per_k == pytest.approx(12e-6)
    assert changed_beam(named, 1.1, (0.0, 0.0)).rigidity_n_mm2 == pytest.approx(1.1 * named.rigidity_n_mm2)


def test_what_is_stated_goes_before_the_material() -> None:
    beam = scene('material = "steel"\nyoungs_modulus_gpa = 200\ndensity_kg_m3 = 7800\nexpansion_um_per_m_k = 11').beam
    assert (beam.modulus_gpa, beam.mass_density_kg_m3) == (200, 7800)
    assert beam.expansion_per_k == pytest.approx(11e-6)
    rigid = scene('material = "steel"\nflexural_rigidity_n_mm2 = 1e7').beam
    assert (rigid.rigidity_n_mm2, rigid.modulus_gpa, rigid.mass_density_kg_m3) == (1e7, None, 7850)


@pytest.mark.parametrize(
    ("instead", "said"),
    [
        (
            'material = "steel"\nyoungs_modulus_gpa = 21',
            "beam.youngs_modulus_gpa = 21 is implausible for steel, which has 190 to 215 GPa; check it",
        ),
        (
            'material = "aluminium"\nflexural_rigidity_n_mm2 = 1.18125e7',
            "beam.flexural_rigidity_n_mm2 = 1.18125e+07 means 210 GPa, which is implausible for aluminium, which has "
            "68 to 79 GPa; check it",
        ),
        (
            'material = "glass-fibre"',
            "glass-fibre is taken with 20 GPa; real pieces have 15 to 28, and forces are wrong by as much: calibrate, "
            "or state youngs_modulus_gpa",
        ),
        ('material = "steel"\nyoungs_modulus_gpa = 206', None),
        ('material = "steel"', None),
    ],
)
def test_a_modulus_that_does_not_fit_its_material_is_a_note_of_commands(
    design_sensors_here: Command, tmp_path: Path, instead: str, said: str | None
) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(PAPER.replace(MODULUS, instead).replace("force_n = 10.0", "force_n = 1.0"))
    done = design_sensors_here("explain", path, "--json")
    assert (done.returncode, done.stderr.split()) == (0, [] if said is None else ["note:", *said.split()])
