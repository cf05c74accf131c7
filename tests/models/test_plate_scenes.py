"""Scenes of plates at the commands: what they refuse, what they price and advise, and where they place sensors."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beamtouch_models import Scene, SceneError, change_scene, influence_matrix, make_scene, read_scene, resolve
from beamtouch_models.design.building.mounted import find_mounted
from beamtouch_models.design.building.remarks import remarks
from beamtouch_models.design.physics.plate import influence, load_places_mm, places_of_sensors
from beamtouch_models.design.physics.structure import changed
from beamtouch_models.design.pricing.of_plates import springs_off
from beamtouch_models.design.scene import identity_of
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.design.scene.tables import Sensors
from beamtouch_models.errors import InputError
from beamtouch_models.runtime.departures import Departures
from support.programs.in_process import Command
from support.surfaces.example_scenes import SCENES

SPRINGS = SCENES / "plate-on-springs.toml"


def on_springs(**tables: dict[str, Any]) -> Scene:
    return change_scene(read_scene(SPRINGS), **tables)


def plate_of(scene: Scene) -> Plate:
    assert scene.plate is not None
    return scene.plate


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"plate": {"supports": []}}, "plate: supports: nothing carries the plate; add supports"),
        (
            {"plate": {"supports": [{"x_mm": x, "y_mm": 0.0} for x in (0.0, 200.0, 400.0)]}},
            "supports: all lie on one line, so the plate can tilt; add a support beside that line",
        ),
        ({"plate": {"supports": [{"x_mm": 401.0, "y_mm": 0.0}]}}, "x_mm = 401 lies off the plate, 0..400 mm"),
        ({"plate": {"supports": [{"x_mm": 1.0, "y_mm": 0.0}] * 2}}, "two stand at x_mm = 1, y_mm = 0; keep one"),
        ({"plate": {"thickness_mm": 0.003}}, "is too small for a plate; if it is in metres, write 3"),
        ({"plate": {"thickness_mm": 90}}, "is too thick for a plate whose shorter side is 300 mm"),
        ({"plate": {"material": None}}, "give material or youngs_modulus_gpa"),
        ({"plate": {"youngs_modulus_gpa": 210_000}}, "plate.youngs_modulus_gpa = 210000 is more than any material has"),
        ({"plate": {"support_stiffness_n_per_mm": 1e-5}}, "plate: a support has 1e-05 N/mm; give 0.001 to 1e+09"),
        ({"contact": {"x_mm": None, "y_mm": None, "position_mm": [1, 9]}}, "a plate has two axes; state x_mm and y_mm"),
        (
            {"plate": {"supports": [{"position_mm": 5}]}},
            "unknown key plate.supports[0].position_mm; places are stated as x_mm and y_mm here",
        ),
        (
            {"sensors": {"fixed": [{"position_mm": 50}]}},
            "unknown key sensors.fixed[0].position_mm; places are stated as x_mm and y_mm here",
        ),
        ({"contact": {"y_mm": [10, 301]}}, "contact.y_mm = [10.0, 301.0] reaches beyond the plate, 0..400 by 0..300"),
        ({"contact": {"width_mm": 300}}, "must be less than the plate's shorter side, 300 mm"),
        ({"sensors": {"fixed": [{"x_mm": 2, "y_mm": 9}]}}, "of size_mm = 12 reaches beyond the edge at x_mm = 0"),
        (
            {"sensors": {"fixed": [{"x_mm": 20, "y_mm": 20}, {"x_mm": 25, "y_mm": 25}]}},
            "20, 20 and 25, 25 mm, 7.07 mm apart, less than size_mm = 12; move one, or correct size_mm",
        ),
        ({"sensors": {"keep_out": [{"x_mm": [500, 600], "y_mm": [0, 9]}]}}, "off the plate, 0..400 by 0..300 mm"),
        ({"sensors": {"keep_out_mm": [[10, 20]]}}, "sensors.keep_out_mm is for a beam; write sensors.keep_out here"),
        ({"beam": {"length_mm": 9, "flexural_rigidity_n_mm2": 1.0}}, "state either beam or plate, not both"),
    ],
)
def test_a_wrong_plate_is_refused_in_one_line(tables: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        on_springs(**tables)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "A contact on a plate has three unknowns",
)
@pytest.mark.parametrize(
    ("count", "force_n", "told"),
    [
        (1, [2, 20], "one sensor does not tell x, y and force of a contact; use 3 or more"),
        (2, [2, 20], "2 sensors do not tell x, y and force"),
        (3, [2, 20], ""),
        (1, 5, "one sensor does not tell x and y of"),
        (2, 5, ""),
        ("auto", [2, 20], ""),
    ],
)
def test_fewer_sensors_than_a_contact_has_unknowns_are_remarked_on(count: object, force_n: object, told: str) -> None:
    said = "\n".join(remarks(on_springs(sensors={"count": count}, contact={"force_n": force_n})))
    assert said.startswith(told) if told else not said


def test_the_influence_matrix_of_beams_refuses_a_plate_and_says_what_has_it() -> None:
    with pytest.raises(SceneError, match=r"this is for beams, but the scene has \[plate\]; `resolve\(scene\)"):
        influence_matrix(read_scene(SPRINGS), [10, 20], [150])


def test_keys_of_plates_are_refused_on_beams() -> None:
    beam = {"length_mm": 400, "material": "steel", "width_mm": 25, "thickness_mm": 3}
    contact, noise = {"force_n": 10, "position_mm": [10, 390]}, {"noise_mm": 0.002}
    with pytest.raises(InputError, match=r"sensors\.fixed is for a plate; write sensors\.fixed_mm here"):
        make_scene(beam=beam, contact=contact, sensors={**noise, "fixed": [{"x_mm": 1, "y_mm": 1}]})


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "A plate that bends by more than half its thickness",
    "is refused, because linear theory does not hold there.",
)
def test_a_plate_that_bends_by_more_than_half_its_thickness_is_refused_and_the_advice_holds() -> None:
    thin = on_springs(plate={"thickness_mm": 1.5})
    with pytest.raises(SceneError, match=r"beyond 0.5 it stretches, and linear theory does not hold") as refused:
        resolve(thin)
    thicker = float(str(refused.value).split("plate.thickness_mm = ")[1].split(" ")[0])
    resolve(on_springs(plate={"thickness_mm": thicker}))
    assert "force_n at" not in str(refused.value)  # its weight alone bends it that far


def test_the_force_that_is_advised_for_a_plate_that_bends_too_far_holds() -> None:
    thin = {"thickness_mm": 2.2}
    with pytest.raises(SceneError, match=r"linear theory does not hold") as refused:
        resolve(on_springs(plate=thin))
    force_n = float(str(refused.value).split("contact.force_n at ")[1].split(" ")[0])
    assert force_n > 1
    resolve(on_springs(plate=thin, contact={"force_n": [force_n / 10, force_n]}))


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "under the largest force and its own weight is refused",
)
def test_a_plate_that_its_own_weight_bends_too_far_needs_no_smaller_force_but_more_thickness() -> None:
    size = {"length_x_mm": 3000, "length_y_mm": 2000}
    contact = {"x_mm": [10, 2990], "y_mm": [10, 1990]}
    with pytest.raises(SceneError, match=r"the plate bends by 15 times its thickness") as refused:
        resolve(on_springs(plate={**size, "thickness_mm": 7}, contact=contact))
    assert "force_n at" not in str(refused.value)
    thicker = float(str(refused.value).split("plate.thickness_mm = ")[1].split(" ")[0])
    assert thicker < 25
    resolve(on_springs(plate={**size, "thickness_mm": thicker}, contact=contact))


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "or more if the shorter one would have fewer than 8.",
)
@pytest.mark.parametrize("size", [(4000.0, 20.0, 5.0), (2000.0, 60.0, 12.0), (400.0, 300.0, 3.0), (60.0, 900.0, 8.0)])
def test_sensors_of_a_narrow_plate_may_stand_on_both_sides_of_its_middle(size: tuple[float, float, float]) -> None:
    plate = Plate(length_x_mm=size[0], length_y_mm=size[1], thickness_mm=size[2], material="steel")
    places, _ = places_of_sensors(plate, Sensors(noise_mm=0.002, size_mm=4))
    assert len(places) < 2500
    for along, length in zip(places.T, plate.size_mm, strict=True):
        assert (along < 0.35 * length).any()
        assert (along > 0.65 * length).any()


def test_explain_prices_what_plates_have(design_sensors_here: Command) -> None:
    done = design_sensors_here("explain", SPRINGS, "--json")
    assert done.returncode == 0
    explained = json.loads(done.stdout)
    effects = {effect["name"]: effect for effect in explained["effects"]}
    assert list(effects)[:6] == [
        "shear", "large deflection", "contact width", "self-weight", "dynamics", "spring stiffness"
    ]  # fmt: skip
    # A plate of 2.83 kg on four springs, and its own flexibility, which makes it slower.
    assert explained["ringing"]["frequency_hz"] == pytest.approx(21.5, abs=2)
    assert effects["shear"]["price"] < 0.2
    assert "1 K between its faces bows it by 120 um" in effects["heat from one side"]["reason"]


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "It advises springs where supports are rigid.",
)
@pytest.mark.parametrize(
    ("supports", "told"),
    [
        ('"corners"', "stands on rigid supports: places are told by small ratios of deflections"),
        ('"corners"\nsupport_stiffness_n_per_mm = 1e6', "stands on springs of 1e+06 N/mm, as on rigid ones: places"),
        ('"edges"', "is held along lines: hardly any place is told from another there"),
    ],
)
def test_explain_advises_springs_before_the_plate_is_bought(
    design_sensors_here: Command, tmp_path: Path, supports: str, told: str
) -> None:
    lines = [line for line in SPRINGS.read_text().splitlines() if "support_stiffness" not in line]
    scene = tmp_path / "rigid.toml"
    scene.write_text("\n".join(lines).replace('"corners"', supports))
    said = " ".join(design_sensors_here("explain", scene).stderr.split())
    assert told in said
    assert 'try supports = "corners" with support_stiffness_n_per_mm = 15' in said
    assert "springs" not in design_sensors_here("explain", SPRINGS).stderr


def test_a_spring_that_is_stiffer_than_said_costs_what_statics_of_a_rigid_plate_on_springs_say() -> None:
    """M = the sum of k v v', v = (1, x, y), makes force and moments of a plane: as read, M0 M^-1 times those there."""
    scene = on_springs(plate={"thickness_mm": 20})  # as good as rigid on 15 N/mm
    corners = np.array([[1, x, y] for x in (0, 400) for y in (0, 300)], dtype=np.float64)
    places = load_places_mm(scene, plate_of(scene))
    applied = np.column_stack([np.ones(len(places)), places])
    said = 15 * corners.T @ corners
    off = springs_off(scene, plate_of(scene))
    for number in range(4):
        stiffness = np.where(np.arange(4) == number, 16.5, 15)
        read = applied @ np.linalg.inv(corners.T @ (stiffness[:, None] * corners)) @ said
        away = np.column_stack([read[:, 1:] / read[:, :1] - places, read[:, 0] - 1])
        # The change is of first order in the flexibility, that of statics of every order.
        assert np.all(np.abs(off[number] - away).max(axis=0) < 0.08 * np.abs(away).max(axis=0))


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "If all are a tenth stiffer, forces are 9 % too small and places hardly differ.",
    "If one of the four is, places are 5 mm off on average",
)
def test_explain_says_what_springs_cost_that_are_stiffer_than_said(design_sensors_here: Command) -> None:
    told = " ".join(design_sensors_here("explain", SPRINGS).stdout.split())
    assert re.search(r"if all are 10 % stiffer than stated, forces are 9\.\d % too small", told)
    assert re.search(r"if one is, places are 4\.\d mm off on average, and 9\.\d mm at most", told)


@pytest.mark.soak
def test_sensors_of_a_plate_on_springs_stand_in_its_corners(design_sensors_roughly: Command, tmp_path: Path) -> None:
    scene = tmp_path / "plate.toml"
    scene.write_text(SPRINGS.read_text().replace("count = 4", "count = 4\ngrid_mm = 25"))
    placed = json.loads(design_sensors_roughly("place", scene, "--json").stdout)
    places = np.array(placed["positions_mm"])
    assert np.abs(places - [[25, 25], [25, 275], [375, 25], [375, 275]]).max() <= 75
    assert places.shape == (4, 2)
    (taken,) = [each for each in placed["compared"] if each["layout"] == "this layout"]
    limit_mm = placed["accuracy_limit_percent"] / 100 * 500
    assert taken["error_mm"] == pytest.approx(limit_mm, rel=0.1)
    table = design_sensors_roughly("place", scene).stdout
    assert "mm from the lower left corner" in table
    assert "% of the diagonal" in table


def test_sensors_of_a_plate_that_are_mounted_stay(tmp_path: Path) -> None:
    places, config = [(20, 20), (380, 20), (200, 280)], tmp_path / "daemon.toml"
    channels = "".join(f"[[surfaces.plate.channels]]\nx_mm = {x}\ny_mm = {y}\n" for x, y in places)
    config.write_text(channels)
    mounted = find_mounted("plate", tmp_path / "plate.onnx", config)
    assert mounted is not None
    assert list(mounted.positions_mm) == places
    assert mounted.fits(on_springs(sensors={"count": 3}))
    assert not mounted.fits(on_springs())  # four are wanted
    assert not mounted.fits(on_springs(plate={"length_y_mm": 250}, contact={"y_mm": [10, 240]}, sensors={"count": 3}))
    assert mounted.moves_to(((20, 20), (380, 20), (210, 280))).endswith("(200, 280) -> (210, 280) mm")


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "Distances are those between places, so a housing keeps half its size from edges, supports and keep-outs.",
)
def test_sensors_keep_the_rules_by_distance() -> None:
    keep_out = [{"x_mm": [100, 300], "y_mm": [100, 200]}]
    surface = resolve(on_springs(sensors={"keep_out": keep_out, "grid_mm": 10, "fixed": [{"x_mm": 13, "y_mm": 17}]}))
    places = surface.rules.place_mm
    assert places[surface.rules.fixed].tolist() == [[13.0, 17.0]]
    to_part = np.linalg.norm(np.maximum([100, 100] - places, 0) + np.maximum(places - [300, 200], 0), axis=1)
    assert to_part.min() >= 6
    assert places.min() >= 6
    assert surface.rules.gap_mm == pytest.approx(12)
    with pytest.raises(
        SceneError, match=r"positions_mm has 13, 17 and 20, 20 mm, 7\.62 mm apart, less than size_mm = 12"
    ):
        surface.layout([[13, 17], [20, 20], [25, 25]])
    with pytest.raises(SceneError, match=r"it lacks \(13, 17\) mm, which is in sensors\.fixed"):
        surface.layout([[200, 50], [300, 50]])
    with pytest.raises(SceneError, match="makes more than 10000 places on the plate; make it coarser"):
        resolve(on_springs(sensors={"grid_mm": 1}))


def test_the_identity_is_that_of_what_moves_the_sensors() -> None:
    scene, sensors = read_scene(SPRINGS), {"s1": (10.0, 20.0), "s2": (30.0, 40.0)}
    own = identity_of(scene, sensors)
    assert identity_of(on_springs(sensors={"noise_mm": 0.004}), dict(reversed(sensors.items()))) == own
    listed = [{"x_mm": x, "y_mm": y} for x in (400.0, 0.0) for y in (300.0, 0.0)]
    assert identity_of(on_springs(plate={"supports": listed}), sensors) == own
    for tables in ({"thickness_mm": 3.1}, {"support_stiffness_n_per_mm": 16}, {"length_y_mm": 301}):
        assert identity_of(on_springs(plate=tables), sensors) != own
    assert identity_of(scene, {"s1": (10.0, 20.0), "s2": (30.0, 41.0)}) != own


def test_a_stiffer_plate_and_its_springs_yield_less_alike() -> None:
    plate, places = read_scene(SPRINGS).plate, np.array([[100.0, 75.0], [350.0, 50.0]])
    assert plate is not None
    none = Departures.none(4)
    stiffer = changed(plate, none.model_copy(update={"rigidity": 1.25}))
    assert isinstance(stiffer, Plate)
    assert influence(stiffer, places, places) == pytest.approx(influence(plate, places, places) / 1.25, rel=1e-9)
    with pytest.raises(SceneError, match="fixity: the supports of a plate are free to rotate; give 0 for both"):
        changed(plate, none.model_copy(update={"fixity": (0.1, 0.0)}))


@pytest.mark.soak
@pytest.mark.parametrize(
    ("stiffness", "percent"), [(None, 2.83), (30.0, 0.66), (15.0, 0.39), (5.0, 0.13)], ids=["rigid", "30", "15", "5"]
)
def test_the_softer_the_corners_the_smaller_the_error(stiffness: float | None, percent: float) -> None:
    """The figures of the guide, measured by other code: samples with 2 um of noise and no other error."""
    plain = {"noise_mm": 0.002, "gain_error_percent": 0.0, "zero_drift_mm": 0.0, "size_mm": 0.0, "range_mm": [1, 8]}
    scene = on_springs(
        plate={"support_stiffness_n_per_mm": stiffness}, sensors=plain, requirements={"latency_ms": None}
    )
    surface = resolve(scene)
    corners, quarters = [(x, y) for x in (10, 390) for y in (10, 290)], [(x, y) for x in (100, 300) for y in (75, 225)]
    limits_mm = [surface.layout(places).limit(draws=1000).value for places in (corners, quarters)]
    assert min(limits_mm) / 5 == pytest.approx(percent, rel=0.1)
