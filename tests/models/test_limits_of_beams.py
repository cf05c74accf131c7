"""Each number of a beam and its sensors is taken up to its limit, and refused beyond it in a whole sentence."""

import pytest

from models.scene_limits import BEAM, MOVE, Tables, beam, contact, made, refusal, sensors, with_all

ON_TWO = [{"at_mm": 100}, {"at_mm": 330}]
SHORT: Tables = {"contact": {"position_mm": [0.1, 0.8]}, "sensors": {"size_mm": 0.1, "keep_out_mm": [[0.3, 0.5]]}}
OF_BEAMS: dict[str, tuple[Tables, Tables, str]] = {
    "shortest": (
        with_all(SHORT, beam(length_mm=1.0, width_mm=4.0, thickness_mm=1.0)),
        with_all(SHORT, beam(length_mm=0.99, width_mm=0.5, thickness_mm=0.1)),
        "beam.length_mm = 0.99 is too small for a beam; if it is in metres, write 990",
    ),
    "narrowest": (
        beam(width_mm=0.1),
        beam(width_mm=0.025),
        "beam.width_mm = 0.025 is too small for a beam; if it is in metres, write 25",
    ),
    "thinnest": (
        beam(thickness_mm=0.01),
        beam(thickness_mm=0.003),
        "beam.thickness_mm = 0.003 is too small for a beam; if it is in metres, write 3",
    ),
    "widest": (
        beam(width_mm=1600),
        beam(width_mm=1601),
        "beam.width_mm = 1601 is too much for beam.length_mm = 400; state all of them in mm, and the length along the "
        "beam",
    ),
    "thickest": (
        beam(thickness_mm=400),
        beam(thickness_mm=401),
        "beam.thickness_mm = 401 is too much for beam.length_mm = 400; state all of them in mm, and the length along "
        "the beam",
    ),
    "thin segment": (
        beam(segments=[{"to_mm": 150}, {"to_mm": 400, "thickness_mm": 0.01}]),
        beam(segments=[{"to_mm": 150}, {"to_mm": 400, "thickness_mm": 0.004}]),
        "beam.segments[1].thickness_mm = 0.004 is too small for a beam; if it is in metres, write 4",
    ),
    "wide segment": (
        beam(segments=[{"to_mm": 150, "width_mm": 1600}, {"to_mm": 400}]),
        beam(segments=[{"to_mm": 150, "width_mm": 1700}, {"to_mm": 400}]),
        "beam.segments[0].width_mm = 1700 is too much for beam.length_mm = 400; state all of them in mm, and the "
        "length along the beam",
    ),
    "modulus in MPa": (
        beam(youngs_modulus_gpa=1500),
        beam(youngs_modulus_gpa=1501),
        "beam.youngs_modulus_gpa = 1501 is more than any material has; if it is in MPa, write 1.501",
    ),
    "modulus in MPa that might be in psi": (
        {},
        beam(youngs_modulus_gpa=1.5e6),
        "beam.youngs_modulus_gpa = 1.5e+06 is more than any material has; if it is in MPa, write 1500",
    ),
    "modulus in psi": (
        {},
        beam(youngs_modulus_gpa=1.6e6),
        "beam.youngs_modulus_gpa = 1.6e+06 is more than any material has; if it is in psi, write 11.03",
    ),
    "modulus in Pa": (
        {},
        beam(youngs_modulus_gpa=2.2e8),
        "beam.youngs_modulus_gpa = 2.2e+08 is more than any material has; if it is in Pa, write 0.22",
    ),
    "modulus in nothing": (
        {},
        beam(youngs_modulus_gpa=1.6e12),
        "beam.youngs_modulus_gpa = 1.6e+12 is more than any material has; state it in GPa",
    ),
    "shear modulus in MPa": (
        beam(youngs_modulus_gpa=1500, shear_modulus_gpa=1499),
        beam(youngs_modulus_gpa=1500, shear_modulus_gpa=80_000),
        "beam.shear_modulus_gpa = 80000 is more than any material has; if it is in MPa, write 80",
    ),
    "shear modulus": (
        beam(shear_modulus_gpa=209),
        beam(shear_modulus_gpa=210),
        "beam.shear_modulus_gpa = 210 must be less than Young's modulus, 210; metals have 0.38 of it",
    ),
    "light": (
        beam(density_kg_m3=20),
        beam(density_kg_m3=19),
        "beam.density_kg_m3 = 19 is less than any material has; if it is in g/cm3, write 19000",
    ),
    "heavy": (
        beam(density_kg_m3=25_000),
        beam(density_kg_m3=25_001),
        "beam.density_kg_m3 = 25001 is more than any material has; state it in kg/m3",
    ),
    "expands little": (
        beam(expansion_um_per_m_k=1e-3),
        beam(expansion_um_per_m_k=0.9e-3),
        "beam.expansion_um_per_m_k = 0.0009 is less than any material has; if it is in 1/K, write 900",
    ),
    "expands much": (
        beam(expansion_um_per_m_k=1000),
        beam(expansion_um_per_m_k=1001),
        "beam.expansion_um_per_m_k = 1001 is more than any material has; state it in um/(m K)",
    ),
    "hardly stiff": (
        {},
        beam(youngs_modulus_gpa=None, flexural_rigidity_n_mm2=2.2e-308),
        "beam: a flexural rigidity of 2.2e-308 N mm^2 cannot be computed with",
    ),
    "contacts from": (
        contact(position_mm=[0, 370]),
        contact(position_mm=[-1, 370]),
        "contact.position_mm = [-1.0, 370.0] reaches beyond the beam, 0..400 mm",
    ),
    "contacts to": (
        contact(position_mm=[20, 400]),
        contact(position_mm=[20, 401]),
        "contact.position_mm = [20.0, 401.0] reaches beyond the beam, 0..400 mm",
    ),
    "contacts in metres": (
        contact(position_mm=[0.1, 0.41]),
        contact(position_mm=[0.1, 0.4]),
        "contact.position_mm = [0.1, 0.4] is next to the left end of the beam; if it is in metres, write [100, 400]",
    ),
    "contacts on two axes": (
        {},
        contact(position_mm=None, x_mm=[20, 370], y_mm=[3, 9]),
        "contact has x_mm and y_mm, but a beam has one axis; state position_mm in their place",
    ),
    "wide contacts": (
        contact(width_mm=399),
        contact(width_mm=400),
        "contact.width_mm = 400 must be less than beam.length_mm = 400",
    ),
    "contacts wider than the beam is long": (
        {},
        contact(width_mm=450),
        "contact.width_mm = 450 must be less than beam.length_mm = 400",
    ),
    "large sensors": (
        sensors(size_mm=399),
        sensors(size_mm=400),
        "sensors.size_mm = 400 must be less than beam.length_mm = 400",
    ),
    "sensors larger than the beam": (
        {},
        sensors(size_mm=450),
        "sensors.size_mm = 450 must be less than beam.length_mm = 400",
    ),
    "noise": (
        sensors(noise_mm=0.5),
        sensors(noise_mm=0.51),
        "sensors.noise_mm = 0.51 is more than a tenth of range_mm; if it is in um, write 0.00051",
    ),
    "sensors off the beam": (
        with_all(beam(supports=ON_TWO), sensors(size_mm=0, fixed_mm=[0, 400])),
        sensors(fixed_mm=[200, 401]),
        "sensors.fixed_mm reaches beyond the beam, 0..400 mm",
    ),
    "segments that end early": (
        {},
        beam(segments=[{"to_mm": 150}, {"to_mm": 350}]),
        "beam: segments end at 350 mm, the beam at 400 mm; they must cover it exactly",
    ),
    "sensors before the beam": (
        {},
        sensors(fixed_mm=[-0.4, 200]),
        "sensors.fixed_mm reaches beyond the beam, 0..400 mm",
    ),
    "keep-out before the beam": (
        sensors(keep_out_mm=[[-9, 1]]),
        sensors(keep_out_mm=[[-9, 0]]),
        "sensors.keep_out_mm has [-9, 0], off the beam, 0..400 mm; correct it, or remove it",
    ),
    "keep-out behind the beam": (
        sensors(keep_out_mm=[[399, 430]]),
        sensors(keep_out_mm=[[400, 430]]),
        "sensors.keep_out_mm has [400, 430], off the beam, 0..400 mm; correct it, or remove it",
    ),
    "housing at the left end": (
        with_all(beam(supports=ON_TWO), sensors(fixed_mm=[6 - 3e-7])),
        with_all(beam(supports=ON_TWO), sensors(fixed_mm=[6 - 1e-5])),
        f"sensors: fixed_mm has 5.99999 mm, where a housing of size_mm = 12 reaches beyond the end at 0 mm; {MOVE}",
    ),
    "housing at the right end": (
        sensors(fixed_mm=[394 + 3e-7]),
        sensors(fixed_mm=[394.1]),
        f"sensors: fixed_mm has 394.1 mm, where a housing of size_mm = 12 reaches beyond the end at 400 mm; {MOVE}",
    ),
    "housing before a support": (
        with_all(beam(supports=ON_TWO), sensors(fixed_mm=[94 + 3e-7])),
        with_all(beam(supports=ON_TWO), sensors(fixed_mm=[94.1])),
        f"sensors: fixed_mm has 94.1 mm, where a housing of size_mm = 12 stands on the support at 100 mm; {MOVE}",
    ),
    "housing behind a support": (
        with_all(beam(supports=ON_TWO), sensors(fixed_mm=[336 - 3e-7])),
        with_all(beam(supports=ON_TWO), sensors(fixed_mm=[335.9])),
        f"sensors: fixed_mm has 335.9 mm, where a housing of size_mm = 12 stands on the support at 330 mm; {MOVE}",
    ),
    "point on a support": (
        with_all(beam(supports=ON_TWO), sensors(size_mm=0, fixed_mm=[330 + 1e-6])),
        with_all(beam(supports=ON_TWO), sensors(size_mm=0, fixed_mm=[330])),
        f"sensors: fixed_mm has 330 mm, where a housing of size_mm = 0 stands on the support at 330 mm; {MOVE}",
    ),
    "housing before a keep-out": (
        sensors(keep_out_mm=[[200, 230]], fixed_mm=[194 + 3e-7]),
        sensors(keep_out_mm=[[200, 230]], fixed_mm=[194.1]),
        "sensors: fixed_mm has 194.1 mm, where a housing of size_mm = 12 reaches into [200, 230] of keep_out_mm; "
        f"{MOVE}",
    ),
    "housing behind a keep-out": (
        sensors(keep_out_mm=[[200, 230]], fixed_mm=[236 - 3e-7]),
        sensors(keep_out_mm=[[200, 230]], fixed_mm=[235.9]),
        "sensors: fixed_mm has 235.9 mm, where a housing of size_mm = 12 reaches into [200, 230] of keep_out_mm; "
        f"{MOVE}",
    ),
    "housings side by side": (
        sensors(fixed_mm=[162 - 3e-7, 150], min_distance_mm=12),
        sensors(fixed_mm=[161.5, 150], min_distance_mm=12),
        "sensors: fixed_mm has 150 and 161.5 mm, 11.5 mm apart, less than size_mm = 12; move one, or correct size_mm",
    ),
    "sensors too close": (
        sensors(fixed_mm=[150, 180], min_distance_mm=30),
        sensors(fixed_mm=[150, 179], min_distance_mm=30),
        "sensors: fixed_mm has 150 and 179 mm, 29 mm apart, less than min_distance_mm = 30; move one, or correct "
        "min_distance_mm",
    ),
    "mounting tolerance": (
        sensors(mounting_tolerance_mm=133, count=[3, 5]),
        sensors(mounting_tolerance_mm=134, count=[3, 5]),
        "sensors.mounting_tolerance_mm = 134: 3 sensors on 400 mm are 133 mm apart; measure their positions to less "
        "than that",
    ),
    "false contacts": (
        {"requirements": {"false_contacts_per_day": 86_400}},
        {"requirements": {"false_contacts_per_day": 86_401}},
        "requirements.false_contacts_per_day = 86401: at sensors.rate_hz = 100 at most 86400 a day, one sample in 100; "
        "state less",
    ),
    "false contacts at another rate": (
        {},
        with_all(sensors(rate_hz=123.457), {"requirements": {"false_contacts_per_day": 2e5}}),
        "requirements.false_contacts_per_day = 200000: at sensors.rate_hz = 123.457 at most 106667 a day, one sample "
        "in 100; state less",
    ),
    "keep-out of a plate": (
        {},
        sensors(keep_out=[{"x_mm": [1, 2], "y_mm": [1, 2]}]),
        "sensors.keep_out is for a plate; write sensors.keep_out_mm here",
    ),
}


@pytest.mark.parametrize("name", OF_BEAMS)
def test_a_beam_is_taken_up_to_a_limit_and_refused_beyond_it(name: str) -> None:
    taken, wrong, said = OF_BEAMS[name]
    made(BEAM, taken)
    assert refusal(BEAM, wrong) == said


def test_a_long_beam_with_everyday_places_is_taken() -> None:
    long = with_all(BEAM, beam(length_mm=2000), contact(position_mm=[20, 1900]))
    assert made(long).sensors.fixed_mm == []
