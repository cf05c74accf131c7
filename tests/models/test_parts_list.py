"""The parts list of a report: what to buy, to drill and to set, with what is stated, assumed and computed."""

from typing import Any

import pytest

from beamtouch_models import change_scene, read_scene
from beamtouch_models.design.building.report.parts import Part, Place, parts_of, places_of, supports_in_words
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.runtime.metadata import Metadata
from beamtouch_models.runtime.metadata_parts import Channel, Influence
from support.surfaces.example_scenes import SCENES
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

BENCH, PLATE = (read_scene(SCENES / f"{name}.toml") for name in ("bench", "plate-on-springs"))
ROWS = [[0.01, 0.05, 0.02], [0.03, 0.02, -0.04], [0.01, 0.01, 0.01], [0.02, 0.04, 0.01]]


def metadata_with(*places: tuple[float, float | None], **parts: object) -> Metadata:
    """Of 1 to 20 N on sensors 3 mm off at rest; a beam of 400 mm, or a plate of 400 by 300."""
    is_plate = bool(places) and places[0][1] is not None
    stated = model_of(outputs=PLATE_OUTPUTS).metadata if is_plate else model_of().metadata
    layout = [Channel(name=f"s{i}", position_mm=x, across_mm=y) for i, (x, y) in enumerate(places, start=1)]
    update: dict[str, object] = {"layout": layout or stated.layout, "influence": Influence(mm_per_n=ROWS)}
    return stated.model_copy(update=update | parts)


def listed(scene: Scene, metadata: Metadata | None = None) -> dict[str, Part]:
    return {part.name: part for part in parts_of(resolve(scene), metadata or metadata_with())}


def row(part: Part) -> tuple[str, str, str]:
    return part.value, part.remark, part.source


def test_holes_of_a_beam_are_from_left_to_right_with_steps_and_housings() -> None:
    scene = change_scene(BENCH, sensors={"fixed_mm": [260.5]})
    metadata = metadata_with((260.5, None), (30.0, None), (120.0, None))
    assert places_of(scene, metadata) == [
        Place("s2", ("30", "370", "90", "24 to 36"), is_fixed=False),
        Place("s3", ("120", "280", "140.5", "114 to 126"), is_fixed=False),
        Place("s1", ("260.5", "139.5", "-", "254.5 to 266.5"), is_fixed=True),
    ]


def test_holes_of_a_plate_are_from_both_edges_with_the_nearest_other() -> None:
    scene = change_scene(PLATE, sensors={"fixed": [{"x_mm": 30.0, "y_mm": 50.0}]})
    assert places_of(scene, metadata_with((330.0, 80.0), (30.0, 50.0), (70.0, 80.0))) == [
        Place("s1", ("330", "80", "70", "220", "260"), is_fixed=False),
        Place("s2", ("30", "50", "370", "250", "50"), is_fixed=True),
        Place("s3", ("70", "80", "330", "220", "50"), is_fixed=False),
    ]
    assert places_of(scene, metadata_with((330.0, 80.0)))[0].distances[-1] == "-"


def test_sensors_are_listed_with_what_a_scene_states_of_them() -> None:
    """The largest force moves them by 1 mm down and 0.8 mm up."""
    parts = listed(BENCH)
    assert row(parts["sensors"]) == ("3, all alike", "housings at most 12 mm wide along the beam", "stated")
    assert row(parts["linear range"]) == ("1 to 4 mm", "gaps between which a sensor measures", "stated")
    told = "set it with the beam in place; with 20 N lying on it, sensors see 2 to 3.8 mm"
    assert row(parts["gap at rest"]) == ("3 mm", told, "computed")
    assert row(parts["resolution"]) == ("12 bits", "1 µm a count", "assumed")
    assert row(parts["rate"]) == ("200 a second", "readings of every sensor", "stated")
    stated = listed(change_scene(BENCH, sensors={"adc_bits": 12, "standoff_mm": 3.0}))
    assert (stated["resolution"].source, stated["gap at rest"].source) == ("stated", "stated")
    bare = listed(change_scene(read_scene(SCENES / "paper.toml"), sensors={}))
    assert bare["sensors"].value == "3, all alike"


def test_errors_are_listed_as_stated_or_assumed() -> None:
    parts = listed(BENCH)
    assert row(parts["gain"]) == ("± 0.3 %", "of each sensor, after calibration", "stated")
    assert row(parts["zero"]) == ("± 1 µm", "of each sensor, since the last tare", "stated")
    assert row(parts["drift"]) == ("± 4.5 µm a minute", "of all zeros together, as a hall warms", "assumed")
    assert parts["noise"].value == "4.51 µm"
    assert (parts["noise"].remark, parts["noise"].source) == ("of a reading, at most", "stated")
    bare = {"gain_error_percent": None, "zero_drift_mm": None}
    assumed = listed(change_scene(BENCH, sensors=bare, environment={"drift_um_per_min": 7.0}))
    assert [assumed[name].source for name in ("gain", "zero", "drift")] == ["assumed", "assumed", "stated"]
    assert assumed["drift"].value == "± 7 µm a minute"


def test_mounting_and_temperature_are_listed() -> None:
    parts = listed(BENCH)
    assert (parts["mounting"].value, parts["mounting"].source) == ("exact", "assumed")
    assert parts["mounting"].remark.startswith("places along the beam; one that is ")
    assert parts["mounting"].remark.endswith(" mm off shows over the noise: measure where it stands, or calibrate")
    assert row(parts["temperature"]) == ("constant", "beside that at which the beam is mounted", "assumed")
    warm: dict[str, dict[str, Any]] = {
        "environment": {"temperature_range_k": (-5.0, 12.5)},
        "sensors": {"mounting_tolerance_mm": 0.4},
    }
    stated = listed(change_scene(BENCH, **warm))
    assert (stated["temperature"].value, stated["temperature"].source) == ("-5 to +12.5 K", "stated")
    assert (stated["mounting"].value, stated["mounting"].source) == ("± 0.4 mm", "stated")


BARE = dict.fromkeys(("youngs_modulus_gpa", "width_mm", "thickness_mm", "density_kg_m3"))
STEPPED = [{"to_mm": 150, "thickness_mm": 4}, {"to_mm": 400}]


@pytest.mark.parametrize(
    ("beam", "size", "remark"),
    [
        ({}, "400 x 25 x 3 mm", "E = 210 GPa"),
        ({"material": "steel"}, "400 x 25 x 3 mm", "steel, E = 210 GPa"),
        (
            {**BARE, "flexural_rigidity_n_mm2": 1.18125e7},
            "400 mm long",
            "E I = 1.181e+07 N mm²",
        ),
        ({"segments": STEPPED}, "400 mm long, in 2 sections", "E = 210 GPa"),
    ],
)  # fmt: skip
def test_a_beam_is_listed_by_what_is_known_of_it(beam: dict[str, Any], size: str, remark: str) -> None:
    parts = listed(change_scene(BENCH, beam=beam))
    assert row(parts["beam"]) == (size, remark, "stated")
    assert ("damping" in parts) == ("density_kg_m3" not in beam)
    if "damping" in parts:
        assert row(parts["damping"]) == ("1 %", "of critical; with less, it rings longer", "assumed")
    damped = listed(change_scene(BENCH, beam={"damping_ratio": 0.0344}))["damping"]
    assert (damped.value, damped.source) == ("3.4 %", "stated")


def test_a_plate_is_listed_with_its_supports() -> None:
    metadata = metadata_with((30.0, 50.0), (330.0, 80.0), (70.0, 80.0))
    parts = listed(PLATE, metadata)
    assert row(parts["plate"]) == ("400 x 300 x 3 mm", "steel, E = 210 GPa, Poisson's ratio 0.3", "stated")
    assert parts["supports"].value == "4"
    assert row(parts["sensors"])[:2] == ("3, all alike", "housings at most 12 mm wide")
    assert parts["gap at rest"].remark.startswith("set it with the plate in place; with 20 N lying on it")
    assert parts["temperature"].remark == "beside that at which the plate is mounted"
    assert parts["mounting"].remark.startswith("places; one that is ")
    bare = listed(change_scene(PLATE, plate={"material": None, "youngs_modulus_gpa": 70.0}), metadata)
    assert bare["plate"].remark == "E = 70 GPa, Poisson's ratio 0.3"
    assert "damping" not in bare


def test_supports_that_are_alike_are_told_together() -> None:
    supports = [{"x_mm": 0.0}, {"y_mm": 90.0}, {"x_mm": 300.0, "y_mm": 200.0, "stiffness_n_per_mm": 8.0}]
    scene = change_scene(PLATE, plate={"supports": supports, "support_stiffness_n_per_mm": None})
    assert scene.plate is not None
    assert supports_in_words(scene.plate) == "rigid at x = 0, y = 90 mm; springs of 8 N/mm at (300, 200) mm"
