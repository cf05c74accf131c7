"""Plates in the simulated world: what the rig plays of them, and what `challenge` puts their models through."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.motion import first_frequency_hz
from beamtouch_models.design.physics.plate import heated, influence
from beamtouch_models.design.scene import load_scene
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.lab.challenge import contacts, faults, plates, ringing
from beamtouch_models.lab.challenge.challenge import Row, misses, rows_of
from beamtouch_models.lab.challenge.play import Case, DrawnContacts, Make, SimulatedSurface
from beamtouch_models.lab.rig.loads import NOTHING, Load
from beamtouch_models.lab.rig.surface import Imperfections, VirtualSurface
from beamtouch_models.runtime import ModelFile, load
from models.rig_process import process_of
from support.programs.in_process import Command
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES
from support.surfaces.plate_models import CORNERS_MM, PLATE_SCENE

SCENE, _ = load_scene(PLATE_SCENE)
assert SCENE.plate
PLATE: Plate = SCENE.plate
LOAD = Load((300.0, 80.0), 10.0)
READINGS = 400


@pytest.fixture(scope="module")
def model(plate_model: Path) -> ModelFile:
    return load(plate_model)


@pytest.fixture(scope="module")
def plate_surface(model: ModelFile) -> SimulatedSurface:
    return SimulatedSurface.of(model.metadata)


def shown_mm(model: ModelFile, imperfect: Imperfections, load: Load) -> Floats:
    """Return the mean deflection (channels,) of a rig under a load that rests, less that of no load."""
    means = []
    for there in (NOTHING, load):
        surface, sensor = VirtualSurface(SCENE, model.metadata, 1, imperfect, rings=False), model.metadata.sensor
        counts = np.mean([surface.counts(there, 0.005 * reading) for reading in range(READINGS)], axis=0)
        means.append(sensor.standoff_mm - sensor.offset_mm - sensor.gain_mm_per_count * counts)
    return np.asarray(means[1] - means[0])


def test_the_rig_bends_a_plate_with_its_imperfections_as_the_theory_does(model: ModelFile) -> None:
    moved = np.array([[1.5, -2.0], [0.0, 1.0], [-1.0, 0.5], [0.0, 0.0]])
    gains, factors = np.array([1.03, 0.98, 1.0, 0.96]), (0.8, 1.1, 1.0, 1.25)
    imperfect = Imperfections(
        x_offset_mm=tuple(moved[:, 0]), y_offset_mm=tuple(moved[:, 1]), gain=tuple(gains), spring_stiffness=factors
    )
    supports = [
        support.model_copy(update={"stiffness_n_per_mm": 15 * factor})
        for support, factor in zip(PLATE.support_list, factors, strict=True)
    ]
    real = PLATE.model_copy(update={"supports": tuple(supports)})
    expected = 10 * influence(real, CORNERS_MM + moved, [[300.0, 80.0]])[0] * gains
    # The mean of as many readings, twice.
    noise_mm = model.metadata.noise.reading_mm * np.sqrt(2 / READINGS)
    assert shown_mm(model, imperfect, LOAD) == pytest.approx(expected, abs=4 * noise_mm)
    assert np.abs(shown_mm(model, Imperfections(), LOAD) - expected).max() > 10 * noise_mm


def test_the_rig_lets_a_plate_ring_at_its_frequency(model: ModelFile) -> None:
    surface, rate_hz = VirtualSurface(SCENE, model.metadata, 1, Imperfections(damping_ratio=0.001)), 1000
    surface.counts(NOTHING, 0.0)
    counts = np.array([surface.counts(Load((200.0, 150.0), 10.0), reading / rate_hz) for reading in range(1, 1001)])
    together = counts.sum(axis=1) - counts.sum(axis=1).mean()
    loudest_hz = np.abs(np.fft.rfft(together)).argmax() * rate_hz / len(together)
    assert loudest_hz == pytest.approx(first_frequency_hz(PLATE), abs=1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("position_offset_mm = [1, 1, 1, 1]", "position_offset_mm is for a beam; leave it out"),
        ("x_offset_mm = [1, 1]", "x_offset_mm has 2 entries for 4 channels"),
        ("y_offset_mm = [0, 15, 0, 0]", "x_offset_mm or y_offset_mm moves a sensor off the plate"),
        ("spring_stiffness = [1, 1]", "spring_stiffness has 2 entries for 4 supports"),
        ("fixity = [0.1, 0.0]", "the supports of a plate are free to rotate"),
    ],
)
def test_imperfections_that_a_plate_cannot_have_are_refused_in_one_line(
    rig_here: Command, plate_model: Path, tmp_path: Path, text: str, said: str
) -> None:
    path = tmp_path / "real.toml"
    path.write_text(text)
    done = rig_here(PLATE_SCENE, "--model", plate_model, "--modbus-tcp", "127.0.0.1:0", "--imperfections", path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr


def test_keys_of_plates_are_refused_on_beams(rig_here: Command, bench_model: Path, tmp_path: Path) -> None:
    path = tmp_path / "real.toml"
    for text in ("x_offset_mm = [1, 1, 1, 1]", "spring_stiffness = [1, 1]"):
        path.write_text(text)
        done = rig_here(
            SCENES / "bench.toml", "--model", bench_model, "--modbus-tcp", "127.0.0.1:0", "--imperfections", path
        )
        assert f"{text.split()[0]} is for a plate; leave it out" in done.stderr


def test_a_model_of_another_kind_of_structure_is_refused(rig_here: Command, bench_model: Path) -> None:
    done = rig_here(PLATE_SCENE, "--model", bench_model, "--modbus-tcp", "127.0.0.1:0")
    assert done.returncode == 2
    assert "it is a model of a beam of 400 mm, but" in done.stderr
    assert "is a scene of a plate of 400 by 300 mm" in done.stderr


def test_a_model_of_a_larger_plate_is_refused(rig_here: Command, plate_model: Path, tmp_path: Path) -> None:
    scene = tmp_path / "small.toml"
    text = PLATE_SCENE.read_text(encoding="utf-8").replace("length_x_mm = 400", "length_x_mm = 350")
    scene.write_text(text.replace("x_mm = [10, 390]", "x_mm = [10, 340]"), encoding="utf-8")
    done = rig_here(scene, "--model", plate_model, "--modbus-tcp", "127.0.0.1:0")
    assert done.returncode == 2
    assert "it is a model of a plate of 400 by 300 mm, but" in done.stderr
    assert "is a scene of a plate of 350 by 300 mm" in done.stderr


def test_the_truth_of_a_plate_has_a_column_for_each_axis(plate_model: Path, tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    options = "--modbus-tcp", "127.0.0.1:0", "--by-hand", "--truth", truth
    with process_of(PLATE_SCENE, "--model", plate_model, *options) as rig:
        assert rig.stdin is not None
        assert rig.stdout is not None
        assert rig.stdout.readline().startswith("listening")
        rig.stdin.write("300 80 10\n")
        rig.stdin.flush()
        assert rig.stdout.readline() == "10 N at (300, 80) mm is on\n"
        # The rig makes the file after it has begun to listen.
        wait_until(lambda: truth.is_file() and truth.read_text().endswith(",300.0000,80.0000,10.0000\n"))
    assert truth.read_text().splitlines()[0] == "unix_time_s,x_mm,y_mm,force_n"


def test_heat_from_one_side_bows_a_plate_by_the_formula_and_leaves_its_corners_alone() -> None:
    """alpha dT l^2 / (8 t) along the diagonal; Timoshenko & Woinowsky-Krieger, 1959, art. 14. Steel: 12e-6 per K."""
    bow_mm = heated(PLATE, np.array([[200.0, 150.0], [0.0, 0.0], [400.0, 300.0], [200.0, 0.0]]))
    middle_mm = 12e-6 * (400**2 + 300**2) / (8 * 3)
    of_x_mm = 12e-6 * 300**2 / (8 * 3)  # beside the middle of an edge, what the other axis bows is missing
    assert bow_mm == pytest.approx([-middle_mm, 0.0, 0.0, -(middle_mm - of_x_mm)], abs=1e-4 * middle_mm)


def only(model: ModelFile, surface: SimulatedSurface, make: Make, draws: int, *, honest: bool = True) -> list[Row]:
    return rows_of(model, surface, Case(honest, make), draws, np.random.default_rng(1))


MAKES: dict[str, tuple[Make, int]] = {
    "at rest": (contacts.rested, 120),
    "a touch": (contacts.touched, 30),
    "a sudden force": (ringing.rings, 20),
    "keeps moving": (partial(contacts.moves, speed_mm_per_s=1000.0, motion=contacts.KEEPS), 20),
}


@pytest.mark.parametrize("share", [0.4, pytest.param(1.0, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", MAKES)
def test_an_honest_contact_on_a_plate_keeps_to_the_goals(
    model: ModelFile, plate_surface: SimulatedSurface, name: str, share: float
) -> None:
    make, draws = MAKES[name]
    for row in only(model, plate_surface, make, round(share * draws)):
        assert misses(row) == [], row


def test_a_load_on_a_plate_moves_as_fast_as_said_in_all_directions(plate_surface: SimulatedSurface) -> None:
    drawn = DrawnContacts.of(plate_surface, 60, np.random.default_rng(2))
    play = contacts.moves(drawn, speed_mm_per_s=300.0)
    steps = np.diff(play.truth_mm[:, -5:], axis=1)
    lengths = np.linalg.norm(steps, axis=2) * plate_surface.metadata.sensor.rate_hz
    assert lengths == pytest.approx(np.full(lengths.shape, 300.0))
    quarters = np.unique(np.sign(steps[:, 0]), axis=0)
    assert len(quarters) == 4
    assert np.all((play.truth_mm >= 10) & (play.truth_mm <= [390, 290]))


@pytest.mark.parametrize(
    "make",
    [
        faults.two_at_the_quarters,
        faults.stuck,
        partial(faults.wedged, touched=True),
        partial(plates.hot_above, touched=False),
    ],
)
def test_what_is_no_single_contact_on_a_plate_is_noticed(
    model: ModelFile, plate_surface: SimulatedSurface, make: Make
) -> None:
    (row,) = only(model, plate_surface, make, 30, honest=False)
    assert row.noticed is not None
    assert row.noticed > 0.9
    assert misses(row) == []


def test_a_contact_on_the_rim_and_one_on_a_softer_spring_keep_their_true_places(
    plate_surface: SimulatedSurface,
) -> None:
    drawn = DrawnContacts.of(plate_surface, 50, np.random.default_rng(3))
    rim = plates.at_the_rim(drawn).truth_mm[:, -1]
    beyond = (rim < [10, 10]) | (rim > [390, 290])
    assert np.all(beyond.sum(axis=1) == 1)
    assert np.all((rim >= 0) & (rim <= [400, 300]))
    softer = plates.spring_gives_way(drawn)
    assert np.array_equal(softer.truth_mm[:, -1], drawn.place_mm)
    # Each is a plate on one spring of 12 N/mm, any of them, and three of 15.
    off_mm = np.array([softer.deflection_mm[:, -1] - drawn.force_n[:, None] * shape for shape in on_a_soft(drawn)])
    assert np.unique(np.abs(off_mm).max(axis=2).argmin(axis=0)).tolist() == [0, 1, 2, 3]
    assert np.abs(off_mm).max(axis=2).min(axis=0).max() < 1e-9


PAGE = Path(__file__).parents[2] / "docs" / "challenge.md"


def test_a_plate_goes_through_the_faults_of_the_page(plate_surface: SimulatedSurface) -> None:
    drawn = DrawnContacts.of(plate_surface, 2, np.random.default_rng(3))
    cases = [*faults.error_cases(plate_surface), *faults.fault_cases(), *plates.plate_cases(plate_surface)]
    names = {case.make(drawn).rows[0][0] for case in cases if not case.honest}
    rows = PAGE.read_text(encoding="utf-8").split("\n## Plates\n")[1].split("\n## ")[0].splitlines()
    assert names == {row.split(" | ")[0].removeprefix("| ") for row in rows if row.startswith("| ")} - {"case"}


def test_heat_adds_the_bow_of_one_kelvin_and_the_rim_bends_by_the_theory(plate_surface: SimulatedSurface) -> None:
    middles = replace(plate_surface, world=replace(plate_surface.world, sensor_mm=MIDDLES_MM))
    drawn = DrawnContacts.of(middles, 30, np.random.default_rng(3))
    for touched in (False, True):
        hot = plates.hot_above(drawn, touched=touched)
        contact_mm = drawn.deflection_mm if touched else 0.0
        assert hot.deflection_mm[:, -1] - contact_mm == pytest.approx(np.tile(heated(PLATE, MIDDLES_MM), (30, 1)))
        assert np.isnan(hot.truth_mm).all() != touched
    rim = plates.at_the_rim(drawn)
    there = rim.truth_mm[:, -1]
    assert rim.deflection_mm[:, -1] == pytest.approx(influence(PLATE, MIDDLES_MM, there) * drawn.force_n[:, None])
    # Ten millimetres deep along each edge; elsewhere a contact is where it was drawn.
    assert plates.beyond_mm(middles).tolist() == [[10.0, 10.0], [10.0, 10.0]]
    moved = there != drawn.place_mm
    assert (moved.sum(axis=1) == 1).all()
    assert np.unique(np.argwhere(moved)[:, 1] * 2 + (there > [200, 150])[moved]).tolist() == [0, 1, 2, 3]


MIDDLES_MM = np.array([[100.0, 75.0], [300.0, 75.0], [150.0, 225.0], [300.0, 200.0]])
"""Places of sensors at which heat shows, which the corners do not."""


def on_a_soft(drawn: DrawnContacts) -> list[Floats]:
    """Return the influence at contacts for each spring that may be softer."""
    return [
        influence(
            PLATE.model_copy(
                update={
                    "supports": tuple(
                        one.model_copy(update={"stiffness_n_per_mm": 12.0 if number == soft else 15.0})
                        for number, one in enumerate(PLATE.support_list)
                    )
                }
            ),
            CORNERS_MM,
            drawn.place_mm,
        )
        for soft in range(4)
    ]
