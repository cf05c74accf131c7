"""Measured structures of which a theory is known, but for a factor a sensor: a few loads are enough."""

from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import Scene, change_scene, load_model, make_scene, resolve
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.measured_structure import measured_structure_of
from beamtouch_models.design.scene import identity_of
from beamtouch_models.errors import InputError
from support.programs.in_process import Command, Refusal

LENGTH_MM, TENSION_N = 500.0, 100.0
SENSORS_MM = {"s1": 60.0, "s2": 180.0, "s3": 320.0, "s4": 440.0}
GAINS = np.array([1.0, 1.3, 0.8, 1.1])
"""Of the sensors, which no theory knows."""
DEPARTS = 0.03
"""Largest part by which the string departs from its theory."""
NOISE_MM = 0.002
EFFORT = 0.05


def by_theory(load_mm: Floats) -> Floats:
    """Return the deflection (loads, sensors) of a pulled string at its sensors, in mm/N."""
    sensor, load = np.array(list(SENSORS_MM.values())), np.asarray(load_mm)[:, None]
    shape: Floats = (np.minimum(sensor, load) - load * sensor / LENGTH_MM) / TENSION_N
    return shape


def truth(load_mm: Floats) -> Floats:
    """Return what the sensors show per newton (loads, sensors): the string is thicker here and there."""
    phase = np.arange(len(SENSORS_MM))
    departs = DEPARTS * np.sin(2 * np.pi * np.asarray(load_mm)[:, None] / 350.0 + phase)
    shown: Floats = by_theory(load_mm) * GAINS * (1 + departs)
    return shown


def optical(deflection_mm: Floats) -> Floats:
    """Return what a sensor shows whose light falls with the square of the gap, of 30 mm at rest."""
    return 10 * ((30.0 / (30.0 - deflection_mm)) ** 2 - 1)


def csv_of(known: Floats, columns: list[str]) -> str:
    head = ",".join(["position_mm", *columns])
    return "\n".join([head, *(",".join(f"{value:.7g}" for value in row) for row in known)]) + "\n"


def theory_csv(factor: float = 1.0) -> str:
    place_mm = np.linspace(0, LENGTH_MM, 126)
    return csv_of(
        np.column_stack([place_mm, factor * by_theory(place_mm)]), [f"{name}_mm_per_n" for name in SENSORS_MM]
    )


def loads_csv(places: int = 6, forces_n: tuple[float, ...] = (4.0, 10.0), *, curved: bool = False) -> str:
    rng = np.random.default_rng(3)
    place_mm = np.repeat(np.linspace(10, 490, places), len(forces_n))
    force_n = np.tile(forces_n, places)
    straight_mm = truth(place_mm) * force_n[:, None]
    shown = (optical(straight_mm) if curved else straight_mm) + 0.3 * NOISE_MM * rng.normal(size=straight_mm.shape)
    return csv_of(
        np.column_stack([place_mm, force_n, shown]), ["force_n", *(f"{name}_deflection_mm" for name in SENSORS_MM)]
    )


def scene_of(**measured: object) -> Scene:
    known = {"influence": loads_csv(), "theory": theory_csv(), "length_mm": LENGTH_MM, "sensors_mm": SENSORS_MM}
    return make_scene(
        measured=known | measured,
        contact={"force_n": [2, 10], "position_mm": [10, 490]},
        sensors={"noise_mm": NOISE_MM, "zero_drift_mm": 0, "rate_hz": 100, "range_mm": [1, 40]},
        environment={"drift_um_per_min": 0},
        requirements={"latency_ms": 50, "descriptors": ["position", "force"]},
    )


def drawn_contacts(seed: int = 4) -> tuple[Floats, Floats]:
    """Return places and forces (contacts,)."""
    rng = np.random.default_rng(seed)
    return rng.uniform(15, 485, 600), rng.uniform(2, 10, 600)


@pytest.mark.promise("docs/how-to/measured.md", "a theory makes do with a few loads")
def test_six_places_are_enough_for_a_string_whose_theory_is_known() -> None:
    with pytest.raises(InputError, match="the loads are too far apart"):
        resolve(scene_of(theory=None))
    model = resolve(scene_of()).place().build("string", effort=EFFORT)
    place_mm, force_n = drawn_contacts()
    noise = NOISE_MM / np.sqrt(5) * np.random.default_rng(5).normal(size=(len(place_mm), 4))
    answers = model.estimate(truth(place_mm) * force_n[:, None] + noise)
    assert (answers["state"] == "contact").all()
    assert np.abs(answers["position_mm"] - place_mm).mean() < 0.015 * LENGTH_MM
    held = (answers["position_low_mm"] <= place_mm) & (place_mm <= answers["position_high_mm"])
    assert held.mean() > 0.93


def test_curved_sensors_are_straightened_by_the_theory_and_the_loads() -> None:
    table = loads_csv(6, (2.0, 4.0, 7.0, 10.0), curved=True)
    model = resolve(scene_of(influence=table, curved=True)).place().build("string", effort=EFFORT)
    place_mm, force_n = drawn_contacts()
    noise = NOISE_MM / np.sqrt(5) * np.random.default_rng(5).normal(size=(len(place_mm), 4))
    shown = model.straighten(optical(truth(place_mm) * force_n[:, None]) + noise)
    answers = model.estimate(shown.deflection_mm, noise_mm=shown.noise_mm / np.sqrt(5))
    is_contact = answers["state"] == "contact"
    assert is_contact.mean() > 0.95
    assert np.abs(answers["position_mm"] - place_mm)[is_contact].mean() < 0.02 * LENGTH_MM
    held = (answers["position_low_mm"] <= place_mm) & (place_mm <= answers["position_high_mm"])
    assert held[is_contact].mean() > 0.93


@pytest.mark.promise("docs/reference/scene.md", "right up to a factor for each sensor only")
def test_a_theory_need_not_know_the_tension() -> None:
    known, unknown = (measured_structure_of(scene_of(theory=theory_csv(factor))) for factor in (1.0, 1000.0))
    places = np.linspace(20, 480, 24)
    assert np.allclose(known.influence(known.sensor_mm, places), unknown.influence(known.sensor_mm, places), rtol=1e-4)


def test_the_deviation_is_that_by_which_the_string_departs() -> None:
    structure = measured_structure_of(scene_of(influence=loads_csv(12)))
    places = np.linspace(15, 485, 95)
    off = structure.influence(structure.sensor_mm, places) - truth(places)
    said = structure.deviation(structure.sensor_mm[:, None], places[:, None])
    assert 0.7 < np.sqrt(np.mean(said**2) / np.mean(off**2)) < 2.0


def test_structures_that_are_simulated_depart_as_far() -> None:
    surface = resolve(scene_of())
    world, rng = surface.layout(list(SENSORS_MM.values())).world, np.random.default_rng(8)
    places = np.linspace(24, 476, 9)
    drawn = np.array([world.draw(rng).under(places, 1.0) for _ in range(100)])
    assert surface.influence.interpolation is not None
    deviation = surface.influence.interpolation.deviation_at(world.sensor_mm[:, None], places[:, None])
    assert np.all(np.abs(drawn.std(axis=0) / deviation - 1) < 0.5)
    assert np.abs((drawn.mean(axis=0) - world.under(places, 1.0)) / deviation).max() < 0.5


def test_a_theory_is_part_of_the_identity() -> None:
    first, second = scene_of(), scene_of(theory=theory_csv(2.0))
    assert identity_of(first, SENSORS_MM) != identity_of(second, SENSORS_MM)


def test_a_model_holds_its_theory(tmp_path: Path, design_sensors_roughly: Command) -> None:
    for name, text in (("loads.csv", loads_csv()), ("theory.csv", theory_csv()), ("string.toml", SCENE)):
        (tmp_path / name).write_text(text)
    built = design_sensors_roughly("build", tmp_path / "string.toml", "-o", tmp_path / "string.onnx")
    assert built.returncode == 0, built.stderr
    assert "that the theory misses the loads costs" in " ".join(built.stderr.split())
    for name in ("loads.csv", "theory.csv", "string.toml"):
        (tmp_path / name).unlink()
    again = design_sensors_roughly("build", tmp_path / "string.onnx", "-o", tmp_path / "again.onnx")
    assert again.returncode == 0, again.stderr
    assert load_model(tmp_path / "string.onnx").identity == load_model(tmp_path / "again.onnx").identity


SCENE = """
[measured]
influence = "loads.csv"
theory = "theory.csv"
length_mm = 500
sensors_mm = { s1 = 60, s2 = 180, s3 = 320, s4 = 440 }

[contact]
force_n = [2, 10]
position_mm = [10, 490]

[sensors]
noise_mm = 0.002
rate_hz = 100
range_mm = [1, 40]
"""


def with_cell(table: str, line: int, column: int, factor: float) -> str:
    rows = [row.split(",") for row in table.splitlines()]
    rows[line][column] = f"{factor * float(rows[line][column]):.6g}"
    return "\n".join(map(",".join, rows)) + "\n"


def times_column(table: str, column: int, factor: float) -> str:
    for line in range(1, len(table.splitlines())):
        table = with_cell(table, line, column, factor)
    return table


def moved() -> str:
    """Return a theory whose sensors stand elsewhere."""
    head, *rows = theory_csv().splitlines()
    return "\n".join([head, *(",".join([row.split(",")[0], *reversed(row.split(",")[1:])]) for row in rows)])


BAD: dict[str, tuple[str, str, str]] = {
    "of another structure": (loads_csv(), moved(), "measured.theory: it misses what"),
    "reversed": (
        loads_csv(),
        times_column(theory_csv(), 2, -1.0),
        "s2 shows the opposite of what it says; change the sign of its column",
    ),
    "a wrong load": (
        with_cell(loads_csv(8), 7, 3, 1.9),
        theory_csv(),
        "under the load at 215.714 mm with 4 N, s2 shows",
    ),
    "of loads": (loads_csv(), loads_csv(), "theory has forces; it is a table of influence"),
    "lacks a sensor": (loads_csv(), theory_csv().replace("s3_mm", "s5_mm"), "theory has no column s3_mm_per_n"),
    "too short": (
        loads_csv(),
        "\n".join(theory_csv().splitlines()[:100]),
        "theory goes from 0 to 392 mm, but the table has a load at 394 mm",
    ),
    "nan": (loads_csv(), with_cell(theory_csv(), 9, 2, float("nan")), "line 10: s2_mm_per_n is nan"),
    "a number": (loads_csv(), "5\n", "column position_mm is missing"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_theory_is_refused_in_one_line_that_says_what_to_do(name: str, tmp_path: Path, refused: Refusal) -> None:
    loads, theory, wanted = BAD[name]
    for file, text in (("loads.csv", loads), ("theory.csv", theory), ("string.toml", SCENE)):
        (tmp_path / file).write_text(text)
    assert wanted in refused("build", tmp_path / "string.toml", "-o", tmp_path / "string.onnx")


def test_contacts_beyond_a_theory_are_refused() -> None:
    short = "\n".join(theory_csv().splitlines()[:125])
    with pytest.raises(InputError, match=r"contact\.position_mm goes from 10 to 495 mm, but measured\.theory"):
        resolve(change_scene(scene_of(theory=short), contact={"position_mm": [10, 495]}))


def test_curved_sensors_that_show_few_loads_are_refused() -> None:
    table = loads_csv(5, (10.0,), curved=True)
    with pytest.raises(InputError, match="s1 shows more than its noise under 5 loads at 5 places, and its"):
        resolve(scene_of(influence=table, curved=True))
