"""Each number of contacts, sensors and requirements is taken up to its limit, and refused beyond it in a sentence."""

import math

import pytest

from beamtouch_models import change_scene, format_scene, make_scene
from beamtouch_models.errors import SceneError
from models.scene_limits import BEAM, PLATE, Tables, beam, contact, made, refusal, sensors, with_all

OF_TABLES: dict[str, tuple[Tables, Tables, str]] = {
    "order of forces": (
        contact(force_n=[20, 20]),
        contact(force_n=[20, 19]),
        "contact: force_n = [20.0, 19.0]: the first must not exceed the second",
    ),
    "order of positions": (
        {},
        contact(position_mm=[50, 50]),
        "contact: position_mm = [50.0, 50.0]: the first must be less than the second",
    ),
    "no places": (
        {},
        contact(position_mm=None),
        "contact: it has no range of places; state position_mm, or x_mm and y_mm on a structure of two axes",
    ),
    "half a place": (
        {},
        contact(position_mm=None, y_mm=[1, 2]),
        "contact: it has y_mm alone; state position_mm, or x_mm and y_mm on a structure of two axes",
    ),
    "all places": (
        {},
        contact(x_mm=[1, 2], y_mm=[1, 2]),
        "contact: it has position_mm, x_mm, y_mm; state position_mm, or x_mm and y_mm on a structure of two axes",
    ),
    "tolerance of a force": (
        contact(force_n=9, force_tolerance_percent=99.9),
        contact(force_n=9, force_tolerance_percent=100),
        "contact.force_tolerance_percent: must be less than 100 (given: 100)",
    ),
    "order of temperatures": (
        {"environment": {"temperature_range_k": [5, 5]}},
        {"environment": {"temperature_range_k": [6, 5]}},
        "environment: temperature_range_k = [6.0, 5.0]: the first must not exceed the second",
    ),
    "absolute temperatures": (
        {"environment": {"temperature_range_k": [150, 160]}},
        {"environment": {"temperature_range_k": [151, 160]}},
        "environment: temperature_range_k = [151.0, 160.0]: state it relative to the temperature of mounting, not "
        "absolute; mounted at 293 K, this is [-142.0, -133.0]",
    ),
    "range of a sensor": (
        {},
        sensors(range_mm=[3, 3]),
        "sensors: range_mm = [3.0, 3.0]: the first must be less than the second",
    ),
    "gap": (
        sensors(range_mm=[0.1, 7]),
        sensors(range_mm=[0, 7]),
        "sensors.range_mm: a gap must be more than 0, not 0",
    ),
    "least stand-off": (
        sensors(standoff_mm=2),
        sensors(standoff_mm=1.9),
        "sensors: standoff_mm = 1.9 lies outside range_mm = [2.0, 7.0]",
    ),
    "largest stand-off": (
        sensors(standoff_mm=7),
        sensors(standoff_mm=7.1),
        "sensors: standoff_mm = 7.1 lies outside range_mm = [2.0, 7.0]",
    ),
    "no noise": (
        sensors(noise_mm=None, noise_percent_of_max=2),
        sensors(noise_mm=None),
        "sensors: give either noise_mm or noise_percent_of_max",
    ),
    "one place twice": (
        sensors(fixed_mm=[200, 300]),
        sensors(fixed_mm=[200, 300, 300]),
        "sensors: fixed_mm names 300 mm twice; two sensors cannot share a position",
    ),
    "order of a keep-out": (
        {},
        sensors(keep_out_mm=[[30, 40], [50, 50]]),
        "sensors: keep_out_mm: the start of a stretch must be less than its end",
    ),
    "order of counts": (
        sensors(count=[3, 3]),
        sensors(count=[4, 3]),
        "sensors.count = [4, 3]: the first must not exceed the second",
    ),
    "fewest": (sensors(count=1), sensors(count=0), "sensors.count: must be at least 1 (given: 0)"),
    "most": (sensors(count=64), sensors(count=65), "sensors.count: must be at most 64 (given: 65)"),
    "few bits": (sensors(adc_bits=6), sensors(adc_bits=5), "sensors.adc_bits: must be at least 6 (given: 5)"),
    "many bits": (sensors(adc_bits=16), sensors(adc_bits=17), "sensors.adc_bits: must be at most 16 (given: 17)"),
    "gain": (
        sensors(gain_error_percent=5),
        sensors(gain_error_percent=5.1),
        "sensors.gain_error_percent: no surface is built of sensors whose gains are known to worse than 5 % after "
        "calibration; calibrate, or use better sensors (given: 5.1)",
    ),
    "drift without temperatures": (
        with_all(sensors(drift_um_per_k=0.2), {"environment": {"temperature_range_k": [0, 1]}}),
        sensors(drift_um_per_k=0.0),
        "sensors.drift_um_per_k needs environment.temperature_range_k, as [-10, 15]",
    ),
    "failed": (
        {"requirements": {"failed_percent": 100}},
        {"requirements": {"failed_percent": 101}},
        "requirements.failed_percent: must be at most 100 (given: 101)",
    ),
    "not damped": (
        beam(damping_ratio=0.99),
        beam(damping_ratio=1),
        "beam.damping_ratio: must be less than 1 (given: 1)",
    ),
    "two moduli": (
        beam(flexural_rigidity_n_mm2=1e7, youngs_modulus_gpa=None),
        beam(flexural_rigidity_n_mm2=1e7),
        "beam: give youngs_modulus_gpa or flexural_rigidity_n_mm2, not both",
    ),
    "supports": (
        beam(supports=[{"at_mm": 0}, {"at_mm": 400}]),
        beam(supports=[{"at_mm": -1}, {"at_mm": 400}]),
        "beam: supports at [-1.0, 400.0] mm: one lies off the beam, 0..400 mm",
    ),
    "ascending segments": (
        {},
        beam(segments=[{"to_mm": 200}, {"to_mm": 200}, {"to_mm": 400}]),
        "beam: segments: to_mm = [200.0, 200.0, 400.0] must ascend",
    ),
}
NOT_NEGATIVE = {
    "contact": ("width_mm", "force_tolerance_percent"),
    "sensors": (
        "noise_mm", "gain_error_percent", "zero_drift_mm", "mounting_tolerance_mm", "drift_um_per_k", "size_mm",
        "min_distance_mm",
    ),
    "environment": ("drift_um_per_min",),
    "requirements": ("failed_percent",),
}  # fmt: skip


@pytest.mark.parametrize("name", OF_TABLES)
def test_a_scene_is_taken_up_to_a_limit_and_refused_beyond_it(name: str) -> None:
    taken, wrong, said = OF_TABLES[name]
    made(BEAM, taken)
    assert refusal(BEAM, wrong) == said


@pytest.mark.parametrize(("table", "key"), [(table, key) for table, keys in NOT_NEGATIVE.items() for key in keys])
def test_nothing_is_a_number_that_less_than_nothing_is_not(table: str, key: str) -> None:
    base = with_all(BEAM, contact(force_n=10), {"environment": {"temperature_range_k": [0, 1]}})
    made(base, {table: {key: 0}})
    assert refusal(base, {table: {key: -1e-9}}) == f"{table}.{key}: must be at least 0 (given: -1e-09)"


NUMBERS = {
    "beam": (
        "length_mm", "youngs_modulus_gpa", "shear_modulus_gpa", "width_mm", "thickness_mm", "density_kg_m3",
        "expansion_um_per_m_k", "foundation_n_mm2",
    ),
    "contact": ("force_n", "width_mm"),
    "sensors": ("noise_mm", "zero_drift_mm", "mounting_tolerance_mm", "rate_hz", "standoff_mm", "drift_um_per_k",
                "size_mm", "min_distance_mm", "grid_mm"),
    "requirements": ("position_error_mm", "latency_ms", "max_mean_ms", "false_contacts_per_day"),
    "environment": ("drift_um_per_min",),
}  # fmt: skip


@pytest.mark.parametrize(("table", "key"), [(table, key) for table, keys in NUMBERS.items() for key in keys])
@pytest.mark.parametrize("value", [math.inf, math.nan])
def test_no_number_of_a_scene_is_infinite(table: str, key: str, value: float) -> None:
    assert f"{table}.{key}: must be a finite number" in refusal(BEAM, {table: {key: value}})


def test_no_place_of_a_scene_is_infinite() -> None:
    for tables, said in (
        (contact(position_mm=[-math.inf, 300]), "contact.position_mm[0]: must be a finite number"),
        (contact(force_n=[3, math.inf]), "contact.force_n[1]: must be a finite number"),
        (sensors(fixed_mm=[100, math.nan]), "sensors.fixed_mm[1]: must be a finite number"),
        (beam(supports=[{"at_mm": math.nan}]), "beam.supports[0].at_mm: must be a finite number"),
    ):
        assert said in refusal(BEAM, tables)


@pytest.mark.parametrize(
    ("meant", "written"),
    [
        ("roller", 'kind = "simple"'),
        ("Clamped", 'kind = "fixed"'),
        ("clamp", 'kind = "fixed"'),
        ("wall", 'kind = "fixed"'),
        ("pinned", 'kind = "simple", slides = false'),
        ("pin", 'kind = "simple", slides = false'),
        ("HINGE", 'kind = "simple", slides = false'),
        ("hinged", 'kind = "simple", slides = false'),
    ],
)
def test_other_names_of_supports_are_told_how_they_are_written(meant: str, written: str) -> None:
    said = refusal(BEAM, beam(supports=[{"at_mm": 0, "kind": meant}, {"at_mm": 400}]))
    assert (
        said == f'beam.supports[0].kind: must be "simple" or "fixed"; for {meant}, write {written} (given: "{meant}")'
    )


def test_what_a_scene_leaves_open_is_as_the_reference_says() -> None:
    scene = made(BEAM, sensors(count="auto", noise_mm=0.01, range_mm=[1, 4]), contact(force_n=8))
    assert (scene.count_range, scene.fewest, scene.sensors.grid_mm, scene.sensors.rate_hz) == ((2, 8), 2, 1, 100)
    assert make_scene(**BEAM | {"sensors": {"noise_mm": 0.01}}).sensors.range_mm == (1, 4)
    assert scene.contact.force_range_n == pytest.approx((7.92, 8.08), rel=1e-12)
    assert scene.contact.assumed_tolerance_percent == 1
    assert made(BEAM).contact.assumed_tolerance_percent is None
    required = scene.requirements
    assert (required.max_mean_ms, required.failed_percent, required.descriptors) == (1000, 10, ("position",))
    assert required.false_contacts_per_day == pytest.approx(0.0333333, rel=1e-5)  # one a month
    assert not scene.wants_force
    assert made(BEAM, {"requirements": {"descriptors": ["force"]}}).wants_force
    assert made(BEAM, sensors(count=[2, 5], fixed_mm=[50, 80, 111])).fewest == 3
    assert made(BEAM, sensors(count=[4, 5], fixed_mm=[50, 80, 111])).fewest == 4


def test_a_changed_scene_has_the_other_keys_of_all_tables() -> None:
    before = made(BEAM, sensors(count=4, fixed_mm=[90]), {"requirements": {"latency_ms": 20}})
    after = change_scene(before, requirements=None, beam={"thickness_mm": 4}, sensors={"fixed_mm": None, "count": 5})
    assert after == made(BEAM, beam(thickness_mm=4), sensors(count=5))
    assert after.requirements.latency_ms is None


def test_a_scene_is_written_with_the_keys_that_it_states_and_no_others() -> None:
    scene = made(BEAM, beam(supports=[{"at_mm": 100, "kind": "fixed"}, {"at_mm": 330}]))
    assert (
        format_scene(scene)
        == """[beam]
length_mm = 400.0
supports = [{ at_mm = 100.0, kind = "fixed" }, { at_mm = 330.0 }]
youngs_modulus_gpa = 210.0
width_mm = 25.0
thickness_mm = 3.0

[contact]
force_n = [2.0, 20.0]
position_mm = [20.0, 370.0]

[sensors]
count = 3
noise_mm = 0.01
range_mm = [2.0, 7.0]
size_mm = 12.0
"""
    )


def test_a_scene_says_what_its_structure_is() -> None:
    scene = made(BEAM)
    assert (scene.has_beam, scene.has_two_axes, scene.is_computed, scene.unit) == (True, False, True, "mm")
    assert (scene.size_mm, scene.length_mm, scene.diagonal_mm) == ((400,), 400, 400)
    scene = made(PLATE)
    assert (scene.has_beam, scene.has_two_axes, scene.is_computed, scene.unit) == (False, True, True, "mm")
    assert (scene.size_mm, scene.length_mm, scene.diagonal_mm) == ((400, 300), 400, 500)
    with pytest.raises(SceneError, match="contact has x_mm and y_mm, and this knows structures of one axis"):
        _ = scene.contact.position_mm
