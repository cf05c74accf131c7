"""What the rig plays at each moment: the loads of its scripts, and the faults of `--fault`."""

from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.rig.faults import Faults
from beamtouch_models.lab.rig.loads import Load, default_script, load_script
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
        assert load_script(path, 400.0).at(seconds) == expected


def test_the_default_script_stays_in_the_range_of_the_scene() -> None:
    script = default_script(load_scene(SCENES / "bench.toml")[0])
    loads = [script.at(time) for time in np.arange(0, 19, 0.05)]
    touching = [load for load in loads if load.position_mm is not None]
    assert 0.6 < len(touching) / len(loads) < 0.95
    assert all(1 <= (load.position_mm or 0) <= 399 and 2 <= load.force_n <= 20 for load in touching)


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
