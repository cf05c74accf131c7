"""Each number of a plate and its sensors is taken up to its limit, and refused beyond it in a whole sentence."""

import pytest

from models.scene_limits import MOVE, PLATE, Tables, contact, made, plate, points, refusal, sensors, with_all

ON_THREE = points((50, 40), (350, 60), (150, 240))
HOUSING = "where a housing of size_mm = 12"
OF_PLATES: dict[str, tuple[Tables, Tables, str]] = {
    "short along x": (
        with_all(plate(length_x_mm=1, thickness_mm=0.2), contact(x_mm=[0.1, 0.9]), sensors(size_mm=0.5)),
        plate(length_x_mm=0.9, thickness_mm=0.2),
        "plate.length_x_mm = 0.9 is too small for a plate; if it is in metres, write 900",
    ),
    "short along y": (
        with_all(plate(length_y_mm=1, thickness_mm=0.2), contact(y_mm=[0.1, 0.9]), sensors(size_mm=0.5)),
        plate(length_x_mm=90, length_y_mm=0.9, thickness_mm=0.05),
        "plate.length_y_mm = 0.9 is too small for a plate; if it is in metres, write 900",
    ),
    "thin": (
        plate(thickness_mm=0.01),
        plate(thickness_mm=0.008),
        "plate.thickness_mm = 0.008 is too small for a plate; if it is in metres, write 8",
    ),
    "thick": (
        plate(thickness_mm=75),
        plate(thickness_mm=76),
        "plate.thickness_mm = 76 is too thick for a plate whose shorter side is 300 mm; state all of them in mm",
    ),
    "light": (
        plate(density_kg_m3=20),
        plate(density_kg_m3=7.85),
        "plate.density_kg_m3 = 7.85 is less than any material has; if it is in g/cm3, write 7850",
    ),
    "soft springs": (
        plate(support_stiffness_n_per_mm=1e-3),
        plate(support_stiffness_n_per_mm=0.9e-3),
        "plate: a support has 0.0009 N/mm; give 0.001 to 1e+09, or leave it out where it is rigid",
    ),
    "stiff springs": (
        plate(support_stiffness_n_per_mm=1e9),
        plate(support_stiffness_n_per_mm=2e9),
        "plate: a support has 2e+09 N/mm; give 0.001 to 1e+09, or leave it out where it is rigid",
    ),
    "contacts from": (
        contact(x_mm=[0, 390]),
        contact(x_mm=[-1, 390]),
        "contact.x_mm = [-1.0, 390.0] reaches beyond the plate, 0..400 by 0..300 mm",
    ),
    "contacts to": (
        contact(y_mm=[20, 300]),
        contact(y_mm=[20, 301]),
        "contact.y_mm = [20.0, 301.0] reaches beyond the plate, 0..400 by 0..300 mm",
    ),
    "contacts in metres": (
        contact(y_mm=[0.02, 0.31]),
        contact(y_mm=[0.02, 0.3]),
        "contact.y_mm = [0.02, 0.3] is next to the edge of the plate; if it is in metres, write [20.0, 300.0]",
    ),
    "wide contacts": (
        contact(width_mm=299),
        contact(width_mm=300),
        "contact.width_mm = 300 must be less than the plate's shorter side, 300 mm",
    ),
    "contacts wider than the plate": (
        {},
        contact(width_mm=350),
        "contact.width_mm = 350 must be less than the plate's shorter side, 300 mm",
    ),
    "large sensors": (
        sensors(size_mm=299),
        sensors(size_mm=300),
        "sensors.size_mm = 300 must be less than the plate's shorter side, 300 mm",
    ),
    "sensors larger than the plate": (
        {},
        sensors(size_mm=350),
        "sensors.size_mm = 350 must be less than the plate's shorter side, 300 mm",
    ),
    "noise": (
        sensors(noise_mm=0.5),
        sensors(noise_mm=0.6),
        "sensors.noise_mm = 0.6 is more than a tenth of range_mm; if it is in um, write 0.0006",
    ),
    "keep-out before the plate": (
        sensors(keep_out=[{"x_mm": [-9, 1], "y_mm": [10, 20]}]),
        sensors(keep_out=[{"x_mm": [-9, 0], "y_mm": [10, 20]}]),
        "sensors.keep_out has x_mm = [-9, 0], y_mm = [10, 20], off the plate, 0..400 by 0..300 mm; correct it, or "
        "remove it",
    ),
    "sensors of a beam": (
        {},
        sensors(fixed_mm=[20]),
        "sensors.fixed_mm is for a beam; write sensors.fixed here",
    ),
    "keep-out behind the plate": (
        sensors(keep_out=[{"x_mm": [10, 20], "y_mm": [299, 330]}]),
        sensors(keep_out=[{"x_mm": [10, 20], "y_mm": [300, 330]}]),
        "sensors.keep_out has x_mm = [10, 20], y_mm = [300, 330], off the plate, 0..400 by 0..300 mm; correct it, or "
        "remove it",
    ),
    "order of a keep-out": (
        {},
        sensors(keep_out=[{"x_mm": [10, 20], "y_mm": [33, 33]}]),
        "sensors.keep_out[0]: y_mm = [33.0, 33.0]: the first must be less than the second",
    ),
    "housing at the left edge": (
        with_all(plate(supports=ON_THREE), sensors(fixed=points((6 - 3e-7, 150)))),
        with_all(plate(supports=ON_THREE), sensors(fixed=points((5.9, 150)))),
        f"sensors: fixed has 5.9, 150 mm, {HOUSING} reaches beyond the edge at x_mm = 0; {MOVE}",
    ),
    "housing at the upper edge": (
        with_all(plate(supports=ON_THREE), sensors(fixed=points((90, 294 + 3e-7)))),
        with_all(plate(supports=ON_THREE), sensors(fixed=points((90, 294.1)))),
        f"sensors: fixed has 90, 294.1 mm, {HOUSING} reaches beyond the edge at y_mm = 300; {MOVE}",
    ),
    "housing beside a support": (
        with_all(plate(supports=ON_THREE), sensors(fixed=points((154.8 - 1e-7, 243.6 - 1e-7)))),
        with_all(plate(supports=ON_THREE), sensors(fixed=points((154.7, 243.6)))),
        f"sensors: fixed has 154.7, 243.6 mm, {HOUSING} stands on the support at x_mm = 150, y_mm = 240; {MOVE}",
    ),
    "housing on a line": (
        with_all(plate(supports=[{"x_mm": 50}, {"x_mm": 350}]), sensors(fixed=points((56, 99)))),
        with_all(plate(supports=[{"x_mm": 50}, {"x_mm": 350}]), sensors(fixed=points((55, 99)))),
        f"sensors: fixed has 55, 99 mm, {HOUSING} stands on the support at x_mm = 50; {MOVE}",
    ),
    "point on a rigid support": (
        with_all(plate(supports=ON_THREE), sensors(size_mm=0, fixed=points((50, 40)))),
        with_all(plate(supports=ON_THREE, support_stiffness_n_per_mm=None), sensors(size_mm=0, fixed=points((50, 40)))),
        "sensors: fixed has 50, 40 mm, where a housing of size_mm = 0 stands on the support at x_mm = 50, y_mm = 40; "
        f"{MOVE}",
    ),
    "housing at the corner of a keep-out": (
        sensors(keep_out=[{"x_mm": [100, 120], "y_mm": [200, 230]}], fixed=points((124.8, 233.6 - 1e-7))),
        sensors(keep_out=[{"x_mm": [100, 120], "y_mm": [200, 230]}], fixed=points((124.7, 233.6))),
        f"sensors: fixed has 124.7, 233.6 mm, {HOUSING} reaches into x_mm = [100, 120], y_mm = [200, 230] of keep_out; "
        f"{MOVE}",
    ),
    "housing before a keep-out": (
        sensors(keep_out=[{"x_mm": [100, 120], "y_mm": [200, 230]}], fixed=points((110, 194))),
        sensors(keep_out=[{"x_mm": [100, 120], "y_mm": [200, 230]}], fixed=points((110, 195))),
        f"sensors: fixed has 110, 195 mm, {HOUSING} reaches into x_mm = [100, 120], y_mm = [200, 230] of keep_out; "
        f"{MOVE}",
    ),
    "point in a keep-out": (
        sensors(size_mm=0, keep_out=[{"x_mm": [100, 120], "y_mm": [200, 230]}], fixed=points((110, 230))),
        sensors(size_mm=0, keep_out=[{"x_mm": [100, 120], "y_mm": [200, 230]}], fixed=points((110, 229))),
        "sensors: fixed has 110, 229 mm, where a housing of size_mm = 0 reaches into x_mm = [100, 120], "
        f"y_mm = [200, 230] of keep_out; {MOVE}",
    ),
    "housings side by side": (
        sensors(fixed=points((50, 50), (57.2, 59.6 - 1e-7)), min_distance_mm=12),
        sensors(fixed=points((50, 50), (57, 59)), min_distance_mm=12),
        "sensors: fixed has 50, 50 and 57, 59 mm, 11.4 mm apart, less than size_mm = 12; move one, or correct size_mm",
    ),
    "sensors too close": (
        sensors(fixed=points((50, 50), (68, 74)), min_distance_mm=30),
        sensors(fixed=points((50, 50), (68, 73)), min_distance_mm=30),
        "sensors: fixed has 50, 50 and 68, 73 mm, 29.2 mm apart, less than min_distance_mm = 30; move one, or correct "
        "min_distance_mm",
    ),
    "the first and the last sensor too close": (
        sensors(fixed=points((50, 50), (90, 30), (68, 74)), min_distance_mm=30),
        sensors(fixed=points((50, 50), (90, 30), (68, 73)), min_distance_mm=30),
        "sensors: fixed has 50, 50 and 68, 73 mm, 29.2 mm apart, less than min_distance_mm = 30; move one, or correct "
        "min_distance_mm",
    ),
    "one place twice": (
        sensors(fixed=points((50, 60), (60, 50))),
        sensors(fixed=points((50, 60), (90, 30), (90, 30))),
        "sensors: fixed names 90, 30 mm twice; two sensors cannot share a place",
    ),
    "lateral contraction": (
        plate(poisson_ratio=0.5),
        plate(poisson_ratio=0.51),
        "plate.poisson_ratio: must be at most 0.5 (given: 0.51)",
    ),
    "no lateral contraction": (
        plate(poisson_ratio=-0.99),
        plate(poisson_ratio=-1),
        "plate.poisson_ratio: must be more than -1 (given: -1)",
    ),
    "hardly stiff": (
        {},
        plate(youngs_modulus_gpa=1e-313),
        "plate: a flexural rigidity of 2.47253e-310 N mm cannot be computed with",
    ),
    "support on the edge": (
        plate(supports=points((0, 0), (400, 0), (200, 300))),
        plate(supports=points((0, 0), (400, -1), (200, 300))),
        "plate: supports: y_mm = -1 lies off the plate, 0..300 mm",
    ),
    "supports nowhere": (
        {},
        plate(supports=[{"stiffness_n_per_mm": 5}]),
        "plate.supports[0]: give x_mm and y_mm for a point, or one of them for a line across the plate",
    ),
    "one line twice": (
        plate(supports=[{"x_mm": 40}, {"x_mm": 50}]),
        plate(supports=[{"x_mm": 40}, {"x_mm": 50}, {"x_mm": 50}]),
        "plate: supports: two stand at x_mm = 50; keep one",
    ),
    "supports nearly on a line": (
        # The line goes by (3, 4) / 5: a point 0.5 mm beside (114, 122) on it has (-0.4, 0.3) more.
        plate(supports=points((30, 10), (240, 290), (113.6, 122.3))),
        plate(supports=points((30, 10), (240, 290), (113.7, 122.2))),
        "plate: supports: all lie on one line, so the plate can tilt; add a support beside that line",
    ),
    "one support": (
        {},
        plate(supports=points((200, 150))),
        "plate: supports: all lie on one line, so the plate can tilt; add a support beside that line",
    ),
    "one line": (
        {},
        plate(supports=[{"y_mm": 150}]),
        "plate: supports: all lie on one line, so the plate can tilt; add a support beside that line",
    ),
}


@pytest.mark.parametrize("name", OF_PLATES)
def test_a_plate_is_taken_up_to_a_limit_and_refused_beyond_it(name: str) -> None:
    taken, wrong, said = OF_PLATES[name]
    made(PLATE, taken)
    assert refusal(PLATE, wrong) == said
