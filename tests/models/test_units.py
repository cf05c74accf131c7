"""Sensors that do not show mm: strain gauges in uV/V, which bend the other way where the bar overhangs its supports."""

import re
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import Model, change_scene, daemon_config, format_scene, load_model, resolve
from beamtouch_models.design.scene import parse_scene
from beamtouch_models.errors import InputError
from beamtouch_models.lab.rig.loads import NOTHING, Load
from beamtouch_models.lab.rig.surface import VirtualSurface
from beamtouch_models.runtime import ModelFile
from support.programs.in_process import Command
from support.surfaces.strain_gauges import GAUGES_MM, LENGTH_MM, influence, loads_csv, scene_of

GAUGES = np.array(list(GAUGES_MM.values()))


@pytest.fixture(scope="module")
def model() -> Model:
    return resolve(scene_of(loads_csv(30))).place().build("bar", effort=0.05)


def test_contacts_are_found_by_channels_that_are_negative_somewhere(model: Model) -> None:
    rng = np.random.default_rng(1)
    place_mm, force_n = rng.uniform(15, LENGTH_MM - 15, 200), rng.uniform(2, 20, 200)
    shown = force_n[:, None] * influence(GAUGES, place_mm)
    assert shown.min() < -100
    assert shown.max() > 100
    answers = model.estimate(shown + 0.25 / np.sqrt(5) * rng.normal(size=shown.shape))
    is_contact = answers["state"] == "contact"
    assert is_contact.mean() > 0.95
    held = (answers["position_low_mm"] <= place_mm) & (place_mm <= answers["position_high_mm"])
    assert held[is_contact].mean() > 0.85
    assert np.abs(answers["position_mm"] - place_mm)[is_contact].mean() < 0.01 * LENGTH_MM


def test_a_correct_load_above_a_gauge_is_no_contradiction_but_one_of_half_the_force_is() -> None:
    """The influence of a gauge has a kink at its place, which no smooth fit expects."""
    for loads in (25, 40):
        resolve(scene_of(loads_csv(loads)))
    head, *rows = loads_csv(30).splitlines()
    at, with_n, *shown = rows[12].split(",")
    rows[12] = ",".join([at, with_n, *(f"{float(value) / 2:.6g}" for value in shown)])
    with pytest.raises(InputError, match=rf"under the load at {float(at):g} mm with {with_n} N, g3 shows .* uV/V, but"):
        resolve(scene_of("\n".join([head, *rows])))


@pytest.mark.promise("docs/how-to/measured.md", "model, daemon and page show that unit")
def test_the_unit_is_in_the_model_and_in_the_configuration_of_the_daemon(
    tmp_path: Path, model: Model, design_sensors_roughly: Command
) -> None:
    assert {channel.unit for channel in model.metadata.layout} == {"uV/V"}
    model.save(tmp_path / "bar.onnx")
    inspected = design_sensors_roughly("inspect", tmp_path / "bar.onnx").stdout
    assert "0.25 uV/V per reading" in inspected
    assert "um" not in inspected.split()
    config = daemon_config(model.metadata)
    assert config.count('value_unit = "uV/V"') == len(GAUGES)
    assert "rest_gap_mm = 0.0" in config
    assert "mm" not in str(resolve(scene_of(loads_csv(30)))).partition("with")[2].split()


def test_a_model_in_mm_says_nothing_of_units(bench: ModelFile) -> None:
    assert {channel.unit for channel in bench.metadata.layout} == {"mm"}
    assert '"unit"' not in bench.metadata.to_entries()["beamtouch.layout"]
    assert "value_unit" not in daemon_config(bench.metadata)


def test_a_table_of_influence_may_be_in_another_unit() -> None:
    place_mm = np.linspace(10, LENGTH_MM - 10, 40)
    head = ",".join(["position_mm", *(f"{name}_\u00b5V/V_per_n" for name in GAUGES_MM)])
    rows = np.column_stack([place_mm, influence(GAUGES, place_mm)]).tolist()
    scene = scene_of("\n".join([head, *(",".join(map(str, row)) for row in rows)]))
    assert scene.unit == "uV/V"
    assert "g1_uV/V_per_n" in format_scene(scene)
    told = resolve(scene).influence.at(GAUGES[:, None], place_mm[:, None])
    assert np.abs(told - influence(GAUGES, place_mm)).max() < 0.03 * np.abs(told).max()


@pytest.mark.parametrize(
    ("sensors", "wanted"),
    [
        ({"range_mm": None}, "sensors.range_mm is missing: state the smallest and the largest value in uV/V"),
        ({"range_mm": [-100, 100]}, r"travels .* uV/V and leaves sensors.range_mm = \[-100, 100\]"),
        ({"noise_mm": 1e9}, "sensors.noise_mm|hides the largest deflection"),
    ],
)
def test_what_does_not_fit_the_unit_is_refused_in_it(sensors: dict[str, object], wanted: str) -> None:
    with pytest.raises(InputError, match=wanted):
        resolve(change_scene(scene_of(loads_csv(30)), sensors=sensors)).place()


LATE = 1.003
"""Part of a period in which polls of 50 a second follow each other."""


def test_recorded_loads_alone_make_a_model_in_their_unit(tmp_path: Path, design_sensors_roughly: Command) -> None:
    rng, rows = np.random.default_rng(2), []
    for load, place in enumerate(np.linspace(10, LENGTH_MM - 10, 30), start=1):
        shown = 10 * influence(GAUGES, np.array([place]))[0]
        rows += [
            f"{60 * load + sample * LATE / 50:.5f},{load},{place:g},10,"
            + ",".join(f"{value:.5f}" for value in shown + 0.25 * rng.normal(size=len(shown)))
            for sample in range(6)
        ]
    head = "unix_time_s,load,position_mm,force_n," + ",".join(f"{name}_deflection_uV/V" for name in GAUGES_MM)
    (tmp_path / "bar.csv").write_text("\n".join([head, *rows]))
    done = design_sensors_roughly("build", "--loads", tmp_path / "bar.csv", "-o", tmp_path / "bar.onnx")
    assert done.returncode == 0, done.stderr
    assert "uV/V of noise in each" in done.noted
    built = load_model(tmp_path / "bar.onnx")
    assert built.metadata.unit == "uV/V"
    assert built.metadata.sensor.standoff_mm == 0
    assert built.metadata.sensor.rate_hz == 50
    in_order = np.array([GAUGES_MM[name] for name in built.channels])  # drawn where they show most
    assert abs(built.estimate(8 * influence(in_order, np.array([300.0])))["position_mm"][0] - 300) < 5


PAN_N = 0.8
"""Weight of a pan that nobody weighed, under each weight."""


def recorded(path: Path, wrong: int = 0) -> Path:
    """Write loads as `record` does; the load of this number has twice the force that it states."""
    rng, rows = np.random.default_rng(3), []
    for load, place in enumerate([40, 60, 170, 200, 230, 260, 290, 320, 345, 445, 465], start=1):
        force_n = 5.0 if load % 2 else 15.0
        true_n = PAN_N + force_n * (2 if load == wrong else 1)
        shown = true_n * influence(GAUGES, np.array([float(place)]))[0]
        rows += [
            f"{load},{place:g},{force_n:g}," + ",".join(f"{v:.5f}" for v in shown + 0.25 * rng.normal(size=len(shown)))
            for _ in range(6)
        ]
    head = "load,position_mm,force_n," + ",".join(f"{name}_deflection_uV/V" for name in GAUGES_MM)
    path.write_text("\n".join([head, *rows]))
    return path


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/measured.md", "it also finds a pan that nobody weighed")
def test_a_pan_that_nobody_weighed_is_named_and_so_is_a_load_that_is_wrong(
    tmp_path: Path, model: Model, design_sensors_roughly: Command
) -> None:
    """The uncertainty that the table leaves between its loads must not look like loads that do not agree."""
    model.save(tmp_path / "bar.onnx")
    read, output = recorded(tmp_path / "loads.csv"), ("-o", tmp_path / "calibrated.onnx")
    done = design_sensors_roughly("calibrate", tmp_path / "bar.onnx", read, *output)
    found = re.search(r"each load presses with ([\d.]+) \+- ([\d.]+) N more than stated", done.stdout)
    assert found, done.stdout + done.stderr
    assert abs(float(found[1]) - PAN_N) < 3 * float(found[2]) < 0.5
    assert "uV/V" in done.stdout
    recorded(read, wrong=7)
    refused = design_sensors_roughly("calibrate", tmp_path / "bar.onnx", read, *output)
    assert refused.returncode == 2
    assert "says 290 mm and 5 N, but the other loads place it at" in refused.noted


@pytest.mark.promise("docs/how-to/measured.md", "A deflection is the value less that at rest")
def test_the_value_of_a_channel_that_is_no_gap_grows_with_its_deflection(model: Model) -> None:
    surface = VirtualSurface(parse_scene(model.metadata.scene, "the scene"), model.metadata, seed=1)
    sensor = model.metadata.sensor
    rest, loaded = (
        np.array(surface.counts(load, seconds)) for load, seconds in ((NOTHING, 0.0), (Load(200.0, 20.0), 1.0))
    )
    shown = sensor.gain_mm_per_count * (loaded - rest)
    assert shown == pytest.approx(20 * influence(model.metadata.layout_mm, np.array([200.0]))[0], abs=2.0)
