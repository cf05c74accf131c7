"""What the rig plays at each moment: the loads of its scripts, and the faults of `--fault`."""

import io
import re
from pathlib import Path

import numpy as np
import pytest

from beamtouch_common.errors import InputError
from beamtouch_common.outline import Outline
from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.rig.faults import Faults
from beamtouch_models.lab.rig.loads import ByHand, Load, default_script, load_of, load_script
from support.running.waiting import wait_until
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


BUILT_IN = (
    (1.0, None, None),
    (2.0, (0.25, 0.25), ("middle", "middle")),
    (3.0, (0.25, 0.75), ("middle", "middle")),
    (1.5, (0.75, 0.75), ("middle", "middle")),
    (1.0, None, None),
    (2.0, (0.5, 0.5), ("largest", "largest")),
    (3.0, (0.5, 0.2), ("largest", "middle")),
    (1.0, None, None),
    (1.5, (0.4, 0.4), ("halfway", "halfway")),
    (2.5, (0.4, 0.8), ("middle", "largest")),
)
"""Seconds of each step, places over the range, and forces, as the page has them."""
FORCES_N = {"halfway": 6.5, "middle": 11.0, "largest": 20.0}
"""Those of a scene with 2 to 20 N."""


def loads_of_built_in(name: str) -> list[tuple[Load, Load]]:
    """The loads at the beginning and near the end of each step of the built-in script, of a scene with 2 to 20 N."""
    scene = load_scene(SCENES / f"{name}.toml")[0]
    contact = scene.contact.model_copy(update={"force_n": (2.0, 20.0), "force_tolerance_percent": 0.0})
    script, begins, loads = default_script(scene.model_copy(update={"contact": contact})), 0.0, []
    for seconds, _, _ in BUILT_IN:
        loads.append((script.at(begins), script.at(begins + seconds * (1 - 1e-9))))
        begins += seconds
    assert script.at(begins + 1.5) == script.at(1.5)  # again and again
    return loads


@pytest.mark.promise(
    "docs/reference/rig.md",
    "Its places are shares of the range of contacts, and its forces those of the scene",
)
def test_the_built_in_script_touches_rests_moves_and_lifts_as_its_table_says() -> None:
    for (_, places, forces), loads in zip(BUILT_IN, loads_of_built_in("bench"), strict=True):
        for end, load in enumerate(loads):
            if places is None or forces is None:
                assert load == Load(None, 0.0)
            else:
                assert load.place_mm == pytest.approx(1 + places[end] * 398, abs=1e-5)
                assert load.force_n == pytest.approx(FORCES_N[forces[end]], abs=1e-6)


def test_the_built_in_script_of_a_plate_falls_along_y_as_it_rises_along_x() -> None:
    for (_, places, _), loads in zip(BUILT_IN, loads_of_built_in("plate-on-springs"), strict=True):
        for end, load in enumerate(loads):
            if places is None:
                assert load.place_mm is None
            else:
                assert load.place_mm == pytest.approx((10 + places[end] * 380, 290 - places[end] * 280), abs=1e-5)


def test_a_script_whose_steps_add_up_to_more_than_its_length_ends_with_its_last_load(tmp_path: Path) -> None:
    path, last_s = tmp_path / "script.toml", 0.6
    assert last_s < 0.1 + 0.2 + 0.3  # as sums of floats are
    moving = "position_mm = [100, 300]\nforce_n = [10, 20]"
    path.write_text(f"[[step]]\nseconds = 0.1\n[[step]]\nseconds = 0.2\n[[step]]\nseconds = 0.3\n{moving}\n")
    script = load_script(path, Outline.of_beam(400.0))
    assert script.at(last_s) == Load(300, 20)
    assert script.at(0.45) == Load(pytest.approx(200), pytest.approx(15))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("line", "load"),
    [("0 0", Load(0, 0)), ("400 12", Load(400, 12)), ("", Load(None, 0)), (" 7.5  1e1 ", Load(7.5, 10))],
)
def test_a_load_by_hand_may_lie_at_either_end_and_weigh_nothing(line: str, load: Load) -> None:
    assert load_of(line, Outline.of_beam(400.0)) == load


@pytest.mark.parametrize("line", ["-0.1 10", "400.1 10", "150 -1", "150 inf", "150 nan", "nan 10"])
def test_a_load_by_hand_beyond_the_beam_or_without_a_force_is_refused(line: str) -> None:
    place, force = line.split()
    said = f"{force} N at {place} mm is no load on a beam of 400 mm"
    with pytest.raises(ValueError, match=f"^{re.escape(said)}$"):
        load_of(line, Outline.of_beam(400.0))


def test_a_script_may_load_both_ends_of_a_beam_and_nothing_beyond(tmp_path: Path) -> None:
    path, beam = tmp_path / "script.toml", Outline.of_beam(400.0)
    for ends in ("0", "400", "[0, 400]", "[400, 0]"):
        path.write_text(f"[[step]]\nseconds = 2\nposition_mm = {ends}\nforce_n = [0, 3]\n")
        assert load_script(path, beam).at(1.0).force_n == 1.5
    for ends in ("-0.5", "400.5", "[0, 400.5]", "[-0.5, 400]"):
        path.write_text(f"[[step]]\nseconds = 1\n[[step]]\nseconds = 2\nposition_mm = {ends}\nforce_n = 3\n")
        with pytest.raises(InputError, match=re.escape("step 2: position_mm must lie on the beam, 0..400 mm")):
            load_script(path, beam)


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
        ("@1..1.5/0.6", (1.0, 1.4, 1.65), (0.45, 0.7, 1.55)),
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


def test_faults_of_sensors_change_the_outputs_of_their_channels_alone() -> None:
    outputs, names = np.array([0.2, 0.3, 0.6, 0.9]), ["s1", "s2", "s3", "s4"]
    for fault, expected in (
        ("unplugged:s3", [0.2, 0.3, 0.0, 0.9]),
        ("inverted:s4", [0.2, 0.3, 0.6, 0.1]),
        ("swapped:s2,s4", [0.2, 0.9, 0.6, 0.3]),
        (" stuck:s2 ", [0.2, 0.3, 0.6, 0.9]),
    ):
        assert Faults(names, [fault]).change(outputs, 0.0) == pytest.approx(expected)
    both = Faults(names, ["swapped:s1,s2", "unplugged:s2"])  # in the order in which they were given
    assert both.change(outputs, 0.0) == pytest.approx([0.3, 0.0, 0.6, 0.9])
    assert outputs.tolist() == [0.2, 0.3, 0.6, 0.9]


def test_a_pause_lasts_as_long_as_the_longest_that_is_on() -> None:
    faults = Faults(["s1"], ["pause@2..5/10", "pause@4..4.5"])
    assert [faults.pause_s(seconds) for seconds in (1.9, 2.0, 4.0, 4.75, 5.0, 13.5)] == [0, 3, 1, 0.25, 0, 1.5]
    faults.add("pause", 7.0)
    assert (faults.pause_s(6.9), faults.pause_s(7.0)) == (0, np.inf)
    faults.mend()
    assert faults.pause_s(7.0) == 0


def test_delays_add_up_while_they_are_on() -> None:
    faults = Faults(["s1"], ["late:80", "late:20@1..2", "pause", "lost:1e-9", "unplugged:s1"])
    assert [faults.delay_s(seconds) for seconds in (0.5, 1.5, 2.5)] == pytest.approx([0.08, 0.1, 0.08])
    assert Faults(["s1"]).delay_s(0.0) == 0


def test_a_percentage_of_the_replies_is_lost_and_the_same_ones_with_the_same_seed() -> None:
    def lost(seed: int, fault: str = "lost:30@0..5000") -> list[bool]:
        faults = Faults(["s1"], [fault, "late:50"], seed)
        return [faults.delay_s(float(second)) is None for second in range(5050)]

    first = lost(1)
    assert np.mean(first[:5000]) == pytest.approx(0.3, abs=0.03)  # more than four standard deviations
    assert not any(first[5000:])
    assert (first == lost(1), first == lost(2)) == (True, False)
    assert Faults(["s1"], ["lost:30"]).delay_s(0.0) == Faults(["s1"], ["lost:30"], 0).delay_s(0.0)
    assert all(lost(1, "lost:100"))


@pytest.mark.parametrize("fault", ["lost:100", "late:60000", "late:0.5", "pause@1.5..2.25/0.8", "stuck:s1@0..3/3.5"])
def test_the_largest_amounts_and_times_with_fractions_are_taken(fault: str) -> None:
    Faults(["s1"], [fault])


PERCENT, DELAY = "give a percentage up to 100, as in lost:10", "give a delay in ms up to 60000, as in late:80"
TIMES = (
    "after @ give the seconds from which and until which it is on, as in @10..20, or @10.., or @0..0.06/0.4 for 0.06 s "
    "every 0.4 s"
)
SENSOR_REPLIES = "with --firmware or a real serial device, only faults of sensors are played"


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        *((f"lost:{amount}", PERCENT) for amount in ("0", "100.5", "-1", "nan", "ten", "")),
        *((f"late:{amount}", DELAY) for amount in ("0", "60001", "-1", "")),
        ("pause:", "give times instead, as in pause@10..12"),
        *((f"pause@{times}", TIMES) for times in ("", "3", "5..5", "5..4", "..5", "1..3/2", "1..3/x", "-1..2")),
        ("stuck:s1,s2", "give one sensor, as in stuck:s1"),
        ("unplugged", "give one sensor, as in unplugged:s1"),
        ("swapped:s1", "give two sensors, as in swapped:s1,s2"),
        ("swapped:s2,s2", "give two sensors, as in swapped:s1,s2"),
        ("swapped:s1,s3", "there is no sensor s3; the sensors are s1, s2"),
    ],
)
def test_a_wrong_fault_is_refused_with_an_example(fault: str, said: str) -> None:
    with pytest.raises(InputError) as refused:
        Faults(["s1", "s2"], [fault])
    assert str(refused.value) == f"fault {fault}: {said}"


def test_a_rig_that_cannot_hold_replies_back_plays_faults_of_sensors_only() -> None:
    Faults(["s1"], ["stuck:s1"], own_line=False)
    with pytest.raises(InputError, match=f"fault late:80: {SENSOR_REPLIES}"):
        Faults(["s1"], ["late:80"], own_line=False)
    typed = Faults(["s1"])
    with pytest.raises(InputError, match="begins at once and ends with mend; leave out @"):
        typed.add("pause@1..2", 3.0)


def test_what_is_typed_touches_lifts_or_is_a_fault_until_it_is_mended(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    faults = Faults(["s1", "s2"])
    by_hand, told = ByHand(Outline.of_beam(400.0), faults), ""
    typed = ("150 12.5", "lost:100", "stuck:s1@2..", "pause", "lift", "mend", "", "7 3")
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(typed)))
    by_hand.follow(lambda: 3.0)

    def has_taken_all() -> bool:
        nonlocal told
        told += capsys.readouterr().out
        return told.count("\n") == len(typed) - 2  # two are wrong

    wait_until(has_taken_all)
    assert told.splitlines() == [
        "12.5 N at 150 mm is on", "lost:100 is on", "pause is on", "no fault is on", "nothing is on",
        "3 N at 7 mm is on",
    ]  # fmt: skip
    assert by_hand.at(0.0) == Load(7, 3)
    assert (faults.pause_s(9.0), faults.delay_s(9.0)) == (0, 0)
