"""What the rig plays at each moment: the loads of its scripts, and the faults of `--fault`."""

import re
from pathlib import Path

import numpy as np
import pytest

from beamtouch_common.errors import InputError
from beamtouch_common.outline import Outline
from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.rig.faults import Faults
from beamtouch_models.lab.rig.loads import Load, default_script, load_of, load_script
from support.surfaces.example_scenes import SCENES

TOUCH_MOVE_LIFT = """
[[step]]
seconds = 1
[[step]]
seconds = 2
position_mm = 100
force_n = 10
[[step]]
seconds = 4
position_mm = [100, 300]
force_n = [10, 20]
"""


@pytest.mark.promise(
    "docs/reference/rig.md",
    "After the last it starts again if `repeat`, else the load is gone for good.",
)
@pytest.mark.parametrize(
    ("seconds", "once", "again"),
    [
        (0.5, Load(None, 0), Load(None, 0)),
        (1.0, Load(100, 10), Load(100, 10)),
        (5.0, Load(200, 15), Load(200, 15)),
        (7.0, Load(None, 0), Load(None, 0)),
        (12.0, Load(None, 0), Load(200, 15)),
    ],
)
def test_a_script_touches_moves_and_lifts_and_repeats_unless_told_otherwise(
    tmp_path: Path, seconds: float, once: Load, again: Load
) -> None:
    path = tmp_path / "script.toml"
    for repeat, expected in (("repeat = false", once), ("", again)):
        path.write_text(repeat + TOUCH_MOVE_LIFT)
        assert load_script(path, Outline.of_beam(400.0)).at(seconds) == expected


PLATE = Outline({"x": 400.0, "y": 300.0})


def test_a_load_on_a_plate_moves_along_both_axes(tmp_path: Path) -> None:
    path = tmp_path / "script.toml"
    path.write_text("[[step]]\nseconds = 4\nx_mm = [100, 300]\ny_mm = 80\nforce_n = [10, 20]\n[[step]]\nseconds = 1\n")
    script = load_script(path, PLATE)
    assert script.at(1.0) == Load((150, 80), 12.5)
    assert script.at(4.5) == Load(None, 0)
    assert load_of("150 80 10", PLATE) == Load((150, 80), 10)


@pytest.mark.parametrize(
    ("outline", "keys", "said"),
    [
        (PLATE, "position_mm = 3\nforce_n = 1", "step 1: position_mm is not for a plate; give x_mm and y_mm"),
        (Outline.of_beam(400.0), "x_mm = 3\ny_mm = 3\nforce_n = 1", "x_mm is not for a beam; give position_mm"),
        (PLATE, "x_mm = 3\nforce_n = 1", "give x_mm, y_mm and force_n together, or none of them for no load"),
        (PLATE, "x_mm = 3\ny_mm = 3", "give x_mm, y_mm and force_n together"),
        (PLATE, "x_mm = 3\ny_mm = 3\nposition_mm = 3\nforce_n = 1", "position_mm on a beam, or x_mm and y_mm on a"),
        (PLATE, "x_mm = 3\ny_mm = [3, 301]\nforce_n = 1", "step 1: y_mm must lie on the plate, 0..300 mm"),
    ],
)
def test_keys_of_another_structure_are_refused_in_one_line(
    tmp_path: Path, outline: Outline, keys: str, said: str
) -> None:
    path = tmp_path / "script.toml"
    path.write_text(f"[[step]]\nseconds = 1\n{keys}\n")
    with pytest.raises(InputError) as refused:
        load_script(path, outline)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("150 10", "give x and y in mm and a force in N, as in 150 80 10"),
        ("150 80 ten", "give x and y in mm"),
        ("150 301 10", "10 N at (150, 301) mm is no load on a plate of 400 by 300 mm"),
    ],
)
def test_a_wrong_load_by_hand_is_refused_in_one_line(line: str, said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        load_of(line, PLATE)


def test_the_default_script_stays_in_the_range_of_the_scene() -> None:
    script = default_script(load_scene(SCENES / "bench.toml")[0])
    loads = [script.at(time) for time in np.arange(0, 19, 0.05)]
    touching = [load for load in loads if isinstance(load.place_mm, float)]
    assert 0.6 < len(touching) / len(loads) < 0.95
    assert all(isinstance(one.place_mm, float) and 1 <= one.place_mm <= 399 for one in touching)
    assert all(2 <= load.force_n <= 20 for load in touching)


def test_the_default_script_of_a_plate_stays_in_both_ranges_and_moves_along_both() -> None:
    script = default_script(load_scene(SCENES / "plate-on-springs.toml")[0])
    loads = [script.at(time) for time in np.arange(0, 19, 0.05)]
    places = np.array([load.place_mm for load in loads if load.place_mm is not None])
    assert np.all((places >= 10) & (places <= [390, 290]))
    assert np.all(np.ptp(places, axis=0) > [150, 100])


@pytest.mark.promise(
    "docs/reference/rig.md",
    "A fault is on all the time, unless `@` and its times in seconds since the start follow",
)
@pytest.mark.parametrize(
    ("times", "on", "off"),
    [
        ("", (0.0, 1e9), ()),
        ("@2..5", (2.0, 4.9), (1.9, 5.0, 1e9)),
        ("@2..", (2.0, 1e9), (1.9,)),
        ("@1..1.5/4", (1.0, 1.4, 5.2, 401.2), (0.9, 1.6, 4.9, 5.6, 403.0)),
    ],
)
def test_a_fault_comes_and_goes_at_its_times(times: str, on: tuple[float, ...], off: tuple[float, ...]) -> None:
    faults = Faults(["s1"], [f"pause{times}"])
    assert all(faults.pause_s(seconds) > 0 for seconds in on)
    assert not any(faults.pause_s(seconds) for seconds in off)


def test_a_sensor_that_is_stuck_now_and_again_stays_where_it_is_each_time() -> None:
    faults = Faults(["s1", "s2"], ["stuck:s1@1..2/3"])
    shown = [faults.change(np.array([0.1 * second, 0.5]), second)[0] for second in np.arange(0.0, 6.0, 0.5)]
    held = [0.0, 0.05, 0.1, 0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.4, 0.5, 0.55]
    assert shown == pytest.approx(held)
